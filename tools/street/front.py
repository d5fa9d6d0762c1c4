# SPDX-License-Identifier: Apache-2.0
"""Parts of the front of a house: walls, windows, shutters, balconies.

Local frame: x along the front, y towards the street, z up, front at y = 0."""

import numpy as np

from mesh import Mesh


class Front:
    def __init__(self, rng, width):
        self.rng, self.mesh, self.texts = rng, Mesh(), []
        self.x0, self.x1, self.width = -width / 2, width / 2, width
        self.trim = self.frame = "trim_white"
        self.window_w = 1.2

    def plane(self, xa, xb, za, zb, material, y=0.0, uvs=None):
        if xb - xa > 1e-3 and zb - za > 1e-3:
            self.mesh.quad(
                (xb, y, za),
                (xa, y, za),
                (xa, y, zb),
                (xb, y, zb),
                material,
                uvs or [(xb, za), (xa, za), (xa, zb), (xb, zb)],
            )

    def bar(self, xa, xb, ya, yb, za, zb, material):
        """Adds a box against the wall, without its back."""
        self.mesh.box(xa, xb, ya, yb, za, zb, material, back=False)

    def window(self, x, width, za, zb, recess, glass, bars, frame, rim=0.055):
        a, c, q = x - width / 2, x + width / 2, self.mesh.quad
        for side in (a, c):
            q((side, 0, za), (side, -recess, za), (side, -recess, zb), (side, 0, zb), self.trim)
        for z in (za, zb):
            q((a, 0, z), (c, 0, z), (c, -recess, z), (a, -recess, z), self.trim)
        self.plane(a, c, za, zb, glass, -recess)
        piece = lambda xa, xb, z0, z1: self.bar(xa, xb, -recess, -recess + 0.05, z0, z1, frame)
        piece(a, a + rim, za, zb)
        piece(c - rim, c, za, zb)
        piece(a, c, za, za + rim)
        piece(a, c, zb - rim, zb)
        for k in range(bars[0]):
            m = a + width * (k + 1) / (bars[0] + 1)
            piece(m - 0.025, m + 0.025, za, zb)
        for k in range(bars[1]):
            m = za + (zb - za) * (0.68 if bars[1] == 1 else (k + 1) / (bars[1] + 1))
            piece(a, c, m - 0.025, m + 0.025)

    def pierced(self, z0, z1, openings, za, zb, material):
        """Adds a wall band from z0 to z1 with openings [(xa, xb)] from za to zb."""
        self.plane(self.x0, self.x1, z0, za, material)
        self.plane(self.x0, self.x1, zb, z1, material)
        edges = [self.x0, *[x for o in openings for x in o], self.x1]
        for k in range(0, len(edges), 2):
            self.plane(edges[k], edges[k + 1], za, zb, material)

    def opening(self, x, width):
        return x - width / 2, x + width / 2

    def shutters(self, x, za, zb):
        leaf = "wood_brown" if self.frame == "wood_brown" else "wood_green"
        for side in (-1, 1):
            m = x + side * (self.window_w / 2 + 0.37)
            self.bar(m - 0.2, m + 0.2, 0.0, 0.05, za, zb, leaf)
            for k in range(11):
                z = za + 0.07 + k * (zb - za - 0.14) / 11
                self.bar(m - 0.16, m + 0.16, 0.05, 0.065, z, z + 0.05, "trim_dark" if k % 2 else self.frame)

    def balcony(self, x, z0):
        rng, box = self.rng, self.mesh.box
        self.bar(x - self.window_w / 2 - 0.3, x + self.window_w / 2 + 0.3, 0, 0.8, z0 + 0.18, z0 + 0.32, self.trim)
        xa, xb = x - self.window_w / 2 - 0.26, x + self.window_w / 2 + 0.26
        box(xa, xb, 0.72, 0.76, z0 + 1.18, z0 + 1.23, "metal_dark")
        rails = int((xb - xa) / 0.11)
        for k in range(rails + 1):
            m = xa + (xb - xa) * k / rails
            box(m - 0.011, m + 0.011, 0.73, 0.752, z0 + 0.32, z0 + 1.18, "metal_dark")
        for m in (xa, xb):
            box(m - 0.02, m + 0.02, 0, 0.74, z0 + 1.18, z0 + 1.22, "metal_dark")
        if rng.random() < 0.6:
            for _ in range(70):
                at = np.array([rng.uniform(xa, xb), 0.78 + rng.gauss(0, 0.07), z0 + 1.05 + rng.gauss(0, 0.16)])
                self.mesh.leaf(at, 0.06, 0.04, rng, rng.choice(["leaf_a", "leaf_b", "leaf_b", "sign_red"]))
