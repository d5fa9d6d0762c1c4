# SPDX-License-Identifier: Apache-2.0
"""Houses: rows of windows, balconies, shops with signs and awnings, doors, cornices, roofs.

Local frame of a house: x along the front, y towards the street, z up, front at y = 0.
"""
import numpy as np

import road
from front import Front
from materials import GLASS, WALLS
from mesh import UNIT_UV, Mesh
from textures import POSTERS

SHOPS = (
    "PEKSEG",
    "BAKERY",
    "CAFE LUNA",
    "PHOTO STUDIO",
    "BOOKS & MAPS",
    "PHARMACY",
    "OPTIKA",
    "FLOWERS",
    "CYCLES 1931",
    "HARDWARE",
    "ANTIK",
    "BISTRO 24",
    "TAILOR",
    "RECORDS",
    "GALERIA",
)
DEPTH_M = 9.0
BASE_Z = -0.5


class House(Front):
    def __init__(self, rng, width, style):
        super().__init__(rng, width)
        self.wall = WALLS[style % len(WALLS)]
        self.base = rng.choice(["stone_block", "stone_dark", self.wall])
        self.trim = rng.choice(["trim_white", "trim_stone", "trim_stone"])
        self.frame = rng.choice(["trim_white", "trim_white", "wood_brown", "wood_green"])
        self.ground_h = rng.uniform(3.4, 4.2)
        self.floors, self.floor_h = rng.choice([2, 2, 3, 3, 4]), rng.uniform(2.9, 3.4)
        self.eaves = self.ground_h + self.floors * self.floor_h
        count = max(2, int(width / rng.uniform(1.9, 2.7)))
        self.pitch = width / count
        self.axes = [self.x0 + self.pitch * (k + 0.5) for k in range(count)]
        self.window_w = min(rng.uniform(0.95, 1.35), self.pitch * 0.62)
        self.bars = rng.choice([(1, 1), (1, 0), (1, 2), (2, 2)])

    def upper_floors(self):
        rng, ww = self.rng, self.window_w
        sill, height = rng.uniform(0.75, 1.0), rng.uniform(1.45, 1.8)
        surround, shutters, balconies = rng.random() < 0.65, rng.random() < 0.3, rng.random() < 0.45
        for floor in range(self.floors):
            z0 = self.ground_h + floor * self.floor_h
            za, zb = z0 + sill, z0 + sill + height
            self.pierced(z0, z0 + self.floor_h, [self.opening(x, ww) for x in self.axes], za, zb, self.wall)
            for k, x in enumerate(self.axes):
                self.window(x, ww, za, zb, 0.17, rng.choice(GLASS), self.bars, self.frame)
                self.bar(x - ww / 2 - 0.1, x + ww / 2 + 0.1, -0.02, 0.13, za - 0.09, za, self.trim)
                if surround:
                    for side in (-1, 1):
                        m = x + side * (ww / 2 + 0.08)
                        self.bar(m - 0.08, m + 0.08, -0.01, 0.045, za, zb, self.trim)
                    self.bar(x - ww / 2 - 0.2, x + ww / 2 + 0.2, -0.01, 0.09, zb, zb + 0.2, self.trim)
                if shutters and self.pitch - ww > 0.9:
                    self.shutters(x, za, zb)
                if balconies and k % 2 == floor % 2 and floor < 3:
                    self.balcony(x, z0)
            self.bar(self.x0, self.x1, -0.01, 0.07, z0 - 0.12, z0 + 0.10, self.trim)

    def shop(self):
        rng, top = self.rng, self.ground_h - 0.95
        count = max(2, int(self.width / 2.6))
        pitch = self.width / count
        axes, width = [self.x0 + pitch * (k + 0.5) for k in range(count)], pitch - 0.45
        door = rng.randrange(count)
        self.pierced(BASE_Z, self.ground_h, [self.opening(x, width) for x in axes], 0.45, top, self.base)
        front = rng.choice(["wood_green", "wood_red", "trim_dark", "wood_brown"])
        for k, x in enumerate(axes):
            self.window(
                x,
                width,
                0.45,
                top,
                0.22,
                rng.choice(["glass_a", "glass_b", "glass_c"]),
                (1, 2 if k == door else 1),
                front,
                0.08,
            )
            if k == door:
                self.bar(x - 0.55, x + 0.55, -0.2, -0.1, -0.3, 2.3, front)
                self.plane(x - 0.4, x + 0.4, 1.0, 2.15, "glass_b", -0.098)
                self.bar(x + 0.35, x + 0.40, -0.1, -0.04, 1.0, 1.3, "alloy")
            elif rng.random() < 0.55:
                for n in range(rng.randrange(1, 4)):  # prints in the shop window
                    h, z = rng.uniform(0.5, 0.95), 0.6 + rng.uniform(0, 0.5)
                    xa = x - width / 2 + 0.15 + n * width / 3.2
                    self.plane(xa, xa + 0.66 * h, z, z + h, f"poster{rng.randrange(POSTERS)}", -0.215, UNIT_UV)
        sign = rng.choice(["sign_red", "sign_blue", "sign_green", "sign_black", "sign_yellow"])
        self.bar(self.x0 + 0.3, self.x1 - 0.3, 0, 0.12, self.ground_h - 0.85, self.ground_h - 0.2, sign)
        self.texts.append(
            (
                rng.choice(SHOPS),
                0.46,
                "sign_black" if sign == "sign_yellow" else "sign_white",
                0,
                0.125,
                self.ground_h - 0.52,
            )
        )
        if rng.random() < 0.55:  # awning
            xa, xb = self.x0 + 0.4, self.x1 - 0.4
            uvs = [(xb, 0), (xa, 0), (xa, 1), (xb, 1)]
            self.mesh.polygon(
                [(xb, 0.02, top), (xa, 0.02, top), (xa, 1.25, top - 0.55), (xb, 1.25, top - 0.55)], "awning", uvs
            )
            self.mesh.polygon(
                [(xb, 1.25, top - 0.55), (xa, 1.25, top - 0.55), (xa, 1.25, top - 0.8), (xb, 1.25, top - 0.8)],
                "awning",
                uvs,
            )
        if rng.random() < 0.7:
            self.projecting_sign()

    def projecting_sign(self):
        rng, q = self.rng, self.mesh.quad
        x, z = self.x0 + rng.uniform(0.8, self.width - 0.8), self.ground_h + 0.55
        self.mesh.box(
            x - 0.03,
            x + 0.03,
            0.1,
            0.95,
            z - 0.35,
            z + 0.35,
            rng.choice(["sign_blue", "sign_red", "sign_green", "sign_yellow"]),
        )
        self.mesh.cylinder((x, 0, z + 0.45), (x, 1.0, z + 0.45), 0.02, 0.02, "metal_dark", 6)
        for side in (-1, 1):
            for i in range(4):
                for j in range(4):
                    if (i + j) % 2:
                        y, low, at = 0.14 + 0.2 * i, z - 0.32 + 0.16 * j, x + side * 0.033
                        q(
                            (at, y, low),
                            (at, y + 0.2, low),
                            (at, y + 0.2, low + 0.16),
                            (at, y, low + 0.16),
                            "sign_white",
                        )

    def dwelling(self):
        """Ground floor with a door, barred windows and posters."""
        rng, ww = self.rng, self.window_w
        door_x = rng.choice(self.axes)
        windows = [x for x in self.axes if x != door_x]
        za, zb = 1.15, min(2.85, self.ground_h - 0.6)
        openings = sorted([self.opening(x, ww) for x in windows] + [self.opening(door_x, 1.24)])
        edges = [self.x0, *[x for o in openings for x in o], self.x1]
        for k in range(0, len(edges), 2):
            self.plane(edges[k], edges[k + 1], BASE_Z, self.ground_h, self.base)
        for x in windows:
            a, c = self.opening(x, ww)
            self.plane(a, c, BASE_Z, za, self.base)
            self.plane(a, c, zb, self.ground_h, self.base)
            self.window(x, ww, za, zb, 0.17, rng.choice(GLASS), self.bars, self.frame)
            self.bar(a - 0.1, c + 0.1, -0.02, 0.12, za - 0.1, za, self.trim)
            if rng.random() < 0.35:
                for k in range(9):
                    m = a + ww * (k + 0.5) / 9
                    self.bar(m - 0.012, m + 0.012, -0.06, -0.035, za, zb, "metal_dark")
        self.door(door_x)
        self.bar(self.x0, self.x1, -0.01, 0.06, BASE_Z, 0.5, rng.choice(["trim_stone", "stone_dark"]))
        if rng.random() < 0.75:
            for k in range(rng.randrange(1, 4)):
                xa = self.x0 + 0.3 + 1.25 * k
                if all(xa > c + 0.1 or xa + 0.95 < a - 0.1 for a, c in openings):
                    self.plane(xa, xa + 0.95, 0.75, 2.18, f"poster{rng.randrange(POSTERS)}", 0.012, UNIT_UV)

    def door(self, x):
        leaf = self.rng.choice(["wood_brown", "wood_green", "wood_red", "wood_brown"])
        self.plane(x - 0.62, x + 0.62, 2.75, self.ground_h, self.base)
        self.plane(x - 0.62, x + 0.62, BASE_Z, 2.2, leaf, -0.25)
        self.plane(x - 0.62, x + 0.62, 2.2, 2.75, "glass_b", -0.25)
        for side in (-1, 1):
            m = x + 0.62 * side
            self.mesh.quad((m, 0, BASE_Z), (m, -0.25, BASE_Z), (m, -0.25, 2.75), (m, 0, 2.75), self.trim)
            self.bar(x + side * 0.72 - 0.1, x + side * 0.72 + 0.1, -0.01, 0.08, -0.3, 2.75, self.trim)
            for z in (0.2, 0.95, 1.55):
                self.bar(
                    x + side * 0.30 - 0.2,
                    x + side * 0.30 + 0.2,
                    -0.25,
                    -0.225,
                    z,
                    z + 0.5,
                    "trim_dark" if leaf == "wood_brown" else leaf,
                )
        self.bar(x - 0.95, x + 0.95, -0.01, 0.25, 2.75, 2.95, self.trim)
        self.mesh.box(x - 0.7, x + 0.7, -0.3, 0.35, -0.4, 0.10, "trim_stone")
        self.bar(x + 0.97, x + 1.33, -0.01, 0.01, 1.95, 2.25, "sign_white")
        self.texts.append((str(self.rng.randrange(1, 99)), 0.22, "sign_black", x + 1.15, 0.012, 2.1))

    def roof(self):
        rng, mesh, top, x0, x1 = self.rng, self.mesh, self.eaves, self.x0, self.x1
        mesh.box(x0 - 0.05, x1 + 0.05, -0.05, 0.35, top - 0.25, top + 0.05, self.trim, back=False)
        self.bar(x0, x1, -0.05, 0.2, top - 0.45, top - 0.25, self.trim)
        for k in range(int(self.width / 0.35)):
            m = x0 + 0.35 * (k + 0.5)
            self.bar(m - 0.07, m + 0.07, 0.15, 0.30, top - 0.40, top - 0.25, self.trim)
        for x in (x0, x1):
            mesh.quad((x, 0, BASE_Z), (x, -DEPTH_M, BASE_Z), (x, -DEPTH_M, top), (x, 0, top), self.wall)
        mesh.quad((x0, -DEPTH_M, BASE_Z), (x1, -DEPTH_M, BASE_Z), (x1, -DEPTH_M, top), (x0, -DEPTH_M, top), self.wall)
        if rng.random() < 0.6:
            ridge_y, ridge_z = -DEPTH_M / 2, top + rng.uniform(1.8, 3.0)
            for eave_y in (0.3, -DEPTH_M - 0.2):
                mesh.quad(
                    (x1, eave_y, top + 0.03),
                    (x0, eave_y, top + 0.03),
                    (x0, ridge_y, ridge_z),
                    (x1, ridge_y, ridge_z),
                    "roof_tile",
                    [(x1, 0), (x0, 0), (x0, 5.5), (x1, 5.5)],
                )
            for x in (x0, x1):
                mesh.polygon(
                    [(x, 0, top), (x, -DEPTH_M, top), (x, ridge_y, ridge_z)],
                    self.wall,
                    [(0, top), (DEPTH_M, top), (-ridge_y, ridge_z)],
                )
            for _ in range(rng.randrange(0, 3)):  # dormers
                x = rng.uniform(x0 + 1, x1 - 1)
                mesh.box(x - 0.5, x + 0.5, -2.4, -0.7, top + 0.3, top + 1.6, self.wall)
                self.plane(x - 0.35, x + 0.35, top + 0.6, top + 1.4, "glass_a", -0.695)
                mesh.box(x - 0.6, x + 0.6, -2.4, -0.6, top + 1.6, top + 1.7, "roof_flat")
        else:
            mesh.quad((x0, 0, top), (x1, 0, top), (x1, -DEPTH_M, top), (x0, -DEPTH_M, top), "roof_flat")
            mesh.box(x0, x1, -0.25, 0.0, top, top + 0.6, self.wall)
        for _ in range(rng.randrange(1, 3)):
            x, y = rng.uniform(x0 + 0.6, x1 - 0.6), -rng.uniform(2, 5)
            mesh.box(x - 0.35, x + 0.35, y - 0.25, y + 0.25, top, top + 3.1, "brick_red")
            mesh.box(x - 0.4, x + 0.4, y - 0.3, y + 0.3, top + 3.1, top + 3.22, "trim_stone")
        mesh.cylinder((x0 + 0.12, 0.10, -0.3), (x0 + 0.12, 0.10, top - 0.4), 0.05, 0.05, "metal_grey", 8)


def _end_block(stage, rng, s, turn):
    """Closes the street's end."""
    mesh = Mesh()
    for i in range(-5, 6):
        for j in range(5):
            x, z, wall = 5.2 * i, 3.2 * j, WALLS[(i + 7) % 5]
            mesh.quad((x + 5.2, 0, z - 0.5), (x, 0, z - 0.5), (x, 0, z + 3.2), (x + 5.2, 0, z + 3.2), wall)
            for k in range(2):
                a = x + 0.6 + 2.4 * k
                mesh.box(a, a + 1.3, -0.1, 0.04, z + 0.9, z + 2.5, "trim_white", back=False)
                mesh.quad(
                    (a + 1.2, 0.045, z + 1),
                    (a + 0.1, 0.045, z + 1),
                    (a + 0.1, 0.045, z + 2.4),
                    (a + 1.2, 0.045, z + 2.4),
                    rng.choice(["glass_a", "curtain", "blinds"]),
                )
    mesh.box(-28, 33, -8, 0.3, 16, 16.6, "trim_stone")
    stage.add("end", mesh, road.frame(s, 0, 0, turn))


def build(stage, settings, end):
    rng = settings.rng("houses")
    for side, style in ((1, 0), (-1, 5)):
        s = road.START_S + 14.0
        while s < end - 30:
            width = rng.uniform(7.5, 13.5)
            # a front is a chord of the bend: longer than its share of the centre line outside, shorter inside
            share = 1 - side * road.FACADE_T * road.curvature(s + width / 2)
            house = House(settings.rng("house", side, style), width, style)
            house.upper_floors()
            house.shop() if house.rng.random() < 0.68 else house.dwelling()
            house.roof()
            world_from_local = road.side_frame(side, s + width / share / 2, road.FACADE_T, 0.0)
            stage.add("house", house.mesh, world_from_local)
            for text in house.texts:
                stage.text(text[0], text[1], text[2], world_from_local, *text[3:])
            style += 1
            s += width / share + 0.06
            if rng.random() < 0.16:
                s += rng.uniform(2.5, 4.0)  # an alley between the houses
    _end_block(stage, rng, end - 25, np.pi / 2)
    _end_block(stage, rng, road.START_S + 8, -np.pi / 2)
