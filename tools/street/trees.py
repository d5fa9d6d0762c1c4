# SPDX-License-Identifier: Apache-2.0
"""Trees: trunk, branches, and leaves as separate rhombi; gravelled pits around the trunks."""
import math

import numpy as np

import road
from ground import near_crossing, pebbles
from mesh import Mesh

KINDS = 4
PIT_T = road.KERB_T + 0.85


def _tree(rng, numbers, leaf):
    mesh = Mesh()
    top = 3.0 + 0.4 * rng.random()
    trunk = [np.array([0, 0, -0.1])] + [
        np.array([rng.gauss(0, 0.05), rng.gauss(0, 0.05), (k + 1) * top / 5]) for k in range(5)
    ]
    radii = (0.20, 0.16, 0.145, 0.135, 0.12, 0.10)
    for k in range(5):
        mesh.cylinder(trunk[k], trunk[k + 1], radii[k], radii[k + 1], "bark", 12, caps=False)
    crown = trunk[-1]
    blobs = [(crown + (0, 0, 1.6), 1.1), (crown + (rng.gauss(0, 0.3), rng.gauss(0, 0.3), 2.6), 0.9)]
    for k in range(9):
        angle, reach = 2 * math.pi * k / 9 * 1.9 + rng.random(), 0.7 * rng.uniform(1.0, 1.9)
        tip = crown + (math.cos(angle) * reach, math.sin(angle) * reach, rng.uniform(0.5, 2.4))
        mesh.cylinder(crown - (0, 0, rng.random()), tip, 0.06, 0.02, "bark", 7, caps=False)
        blobs.append((tip, rng.uniform(0.55, 0.95)))
    for center, radius in blobs:
        count = int(900 * radius * radius)
        out = numbers.normal(size=(count, 3))
        out /= np.linalg.norm(out, axis=1, keepdims=True)
        at = center + out * radius * numbers.uniform(0.45, 1.05, (count, 1)) ** 0.6 * np.array([1, 1, 0.8])
        along = numbers.normal(size=(count, 3))
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        across = np.cross(along, out)
        across /= np.linalg.norm(across, axis=1, keepdims=True) + 1e-9
        size = numbers.uniform(0.06, 0.125, (count, 1))
        for p, a, b in zip(at, along * size, across * size * 0.55):
            mesh.polygon([p - a, p + b, p + a, p - b], leaf)
    return mesh


def _pit():
    mesh = Mesh()
    mesh.box(-0.55, 0.55, -0.45, 0.45, -0.05, 0.015, "soil")
    for x0, x1, y0, y1 in (
        (-0.6, 0.6, -0.5, -0.45),
        (-0.6, 0.6, 0.45, 0.5),
        (-0.6, -0.55, -0.5, 0.5),
        (0.55, 0.6, -0.5, 0.5),
    ):
        mesh.box(x0, x1, y0, y1, -0.05, 0.07, "kerb_base")
    return mesh


def build(stage, settings, end):
    rng = settings.rng("trees")
    kinds = [
        _tree(settings.rng("tree", k), settings.np_rng("leaves", k), ("leaf_a", "leaf_b", "leaf_c")[k % 3]).data(
            f"tree{k}", stage.materials, weld=False
        )
        for k in range(KINDS)
    ]
    pit = _pit()
    pebbles(pit, rng, 420, 0.53, 0.43, 0.015)
    pit = pit.data("pit", stage.materials)
    for side in (1, -1):
        for s in np.arange(-28 + (5 if side > 0 else 0), end - 70, 13.0):
            if rng.random() < 0.2 or near_crossing(s):
                continue
            at = s + rng.uniform(-1, 1)
            world_from_local = road.frame(at, side * PIT_T, turn=rng.uniform(0, 6))
            world_from_local[:3, :3] *= rng.uniform(0.85, 1.12)
            stage.place("tree", rng.choice(kinds), world_from_local)
            stage.place("pit", pit, road.frame(at, side * PIT_T))
    for _ in range(16):  # crowns behind the houses
        world_from_local = road.frame(rng.uniform(-40, end - 50), rng.choice([-1, 1]) * rng.uniform(19, 26), 0)
        world_from_local[:3, :3] *= rng.uniform(1.5, 2.2)
        stage.place("tree", rng.choice(kinds), world_from_local)
