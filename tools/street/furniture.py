# SPDX-License-Identifier: Apache-2.0
"""Lamps, traffic signs, bollards, bins, planters, benches, railings, wires, advertising columns, the bus shelter."""
import math

import numpy as np

import road
from ground import near_crossing
from mesh import UNIT_UV, Mesh
from road import KERB_T
from textures import POSTERS

SIGNS = (
    (19, -1, "round", "30"),
    (33, -1, "square", "P"),
    (44, -1, "triangle", "!"),
    (53, -1, "square", "A"),
    (62, 1, "round", "40"),
    (70, -1, "check", None),
    (27, 1, "square", "P"),
    (39, 1, "check", None),
    (50, 1, "triangle", "!"),
    (84, -1, "round", "50"),
    (96, -1, "square", "P"),
    (4, -1, "check", None),
    (8, 1, "round", "30"),
    (-8, -1, "square", "P"),
    (110, 1, "check", None),
)
COLUMNS = ((28.0, -1), (41.5, 1), (74.0, -1), (57.0, 1))
WIRES_S = (17, 31.5, 47, 66, 88, 112)


def _lamp():
    mesh = Mesh()
    mesh.cylinder((0, 0, -0.1), (0, 0, 0.8), 0.10, 0.085, "metal_dark", 14)
    mesh.cylinder((0, 0, 0.8), (0, 0, 5.8), 0.06, 0.045, "metal_dark", 12)
    for z, r in ((0.8, 0.12), (0.25, 0.12), (3.2, 0.07)):
        mesh.cylinder((0, 0, z), (0, 0, z + 0.06), r, r, "metal_dark", 14)
    arm = [(0, 1.3 * (1 - math.cos(a)), 5.8 + 0.7 * math.sin(a)) for a in np.linspace(0, math.pi / 2, 7)]
    mesh.tube(arm, 0.035, "metal_dark")
    mesh.box(-0.13, 0.13, 1.15, 1.75, 6.40, 6.52, "metal_grey")
    mesh.box(-0.10, 0.10, 1.2, 1.7, 6.37, 6.40, "lamp_white")
    return mesh


def _sign(stage, s, side, kind, words):
    """Faces the traffic of its side."""
    world_from_local = road.frame(s, side * (KERB_T + 0.40), turn=-side * math.pi / 2)
    mesh, z = Mesh(), 2.4
    mesh.cylinder((0, 0, -0.1), (0, 0, 2.75), 0.03, 0.03, "metal_grey", 10)
    if kind == "round":
        mesh.cylinder((0, 0.035, z), (0, 0.050, z), 0.32, 0.32, "sign_red", 28)
        mesh.cylinder((0, 0.04, z), (0, 0.054, z), 0.245, 0.245, "sign_white", 28)
    elif kind == "square":
        mesh.box(-0.32, 0.32, 0.03, 0.05, 2.1, 2.74, "sign_white")
        mesh.box(-0.30, 0.30, 0.03, 0.052, 2.12, 2.72, "sign_blue")
    elif kind == "triangle":
        mesh.polygon([(-0.38, 0.05, 2.12), (0.38, 0.05, 2.12), (0, 0.05, 2.78)], "sign_red")
        mesh.polygon([(-0.25, 0.054, 2.20), (0.25, 0.054, 2.20), (0, 0.054, 2.63)], "sign_white")
    else:
        for i in range(6):
            for j in range(6):
                mesh.box(
                    -0.36 + 0.12 * i,
                    -0.24 + 0.12 * i,
                    0.03,
                    0.05,
                    2.0 + 0.12 * j,
                    2.12 + 0.12 * j,
                    "sign_white" if (i + j) % 2 else "sign_black",
                )
    stage.add("sign", mesh, world_from_local)
    if words:
        size, height = (0.22, 2.34) if kind == "triangle" else (0.30, z)
        stage.text(words, size, "sign_white" if kind == "square" else "sign_black", world_from_local, 0, 0.058, height)


def _bench():
    mesh = Mesh()
    for k in range(4):
        mesh.box(-0.8, 0.8, -0.05 + 0.11 * k, 0.03 + 0.11 * k, 0.43, 0.47, "wood_brown")
    for k in range(3):
        mesh.box(-0.8, 0.8, -0.10, -0.06, 0.55 + 0.13 * k, 0.64 + 0.13 * k, "wood_brown")
    for x in (-0.65, 0.65):
        mesh.box(x - 0.03, x + 0.03, -0.1, 0.35, 0, 0.43, "metal_dark")
        mesh.box(x - 0.03, x + 0.03, -0.12, -0.08, 0, 0.9, "metal_dark")
    return mesh


def _pavement_things(stage, rng, end):
    mesh = Mesh()
    bench = _bench().data("bench", stage.materials)
    for side in (1, -1):
        for s in np.arange(-30, end - 80, 2.6):
            if rng.random() < 0.45 and s % 40 < 16:
                foot = np.array(road.ground_point(s, side * (KERB_T + 0.35)))
                mesh.cylinder(foot - (0, 0, 0.05), foot + (0, 0, 0.85), 0.055, 0.055, "metal_dark", 12)
                mesh.cylinder(foot + (0, 0, 0.62), foot + (0, 0, 0.72), 0.058, 0.058, "sign_white", 12)
        for s in np.arange(-20, end - 90, 17.0):
            s, kind = s + rng.uniform(-3, 3), rng.random()
            foot = np.array(road.ground_point(s, side * (KERB_T + 1.9)))
            if kind < 0.35:
                mesh.cylinder(foot, foot + (0, 0, 0.9), 0.22, 0.26, "wood_green", 16)
                mesh.cylinder(foot + (0, 0, 0.9), foot + (0, 0, 1.0), 0.28, 0.18, "metal_dark", 16)
            elif kind < 0.7:
                mesh.cylinder(foot, foot + (0, 0, 0.55), 0.42, 0.55, "concrete", 18)
                for k in range(260):
                    at = foot + (rng.gauss(0, 0.25), rng.gauss(0, 0.25), 0.55 + abs(rng.gauss(0, 0.28)))
                    blossom = (
                        rng.choice(["sign_yellow", "sign_red"])
                        if k % 9 == 0
                        else rng.choice(["leaf_a", "leaf_b", "leaf_c"])
                    )
                    mesh.leaf(at, 0.09, 0.05, rng, blossom)
            else:
                stage.place("bench", bench, road.side_frame(side, s, KERB_T + 2.2))
    stage.add("pavement things", mesh)


def _railings(stage):
    """Before and behind the crossing, at the kerb."""
    mesh = Mesh()
    for side in (1, -1):
        for s0, s1 in ((46.0, 53.5), (60.5, 67.0)):
            posts = [np.array(road.ground_point(s, side * (KERB_T + 0.22))) for s in np.arange(s0, s1, 1.4)]
            for a, b in zip(posts[:-1], posts[1:]):
                mesh.cylinder(a - (0, 0, 0.05), a + (0, 0, 1.05), 0.03, 0.03, "metal_dark", 8)
                for z in (0.18, 1.0):
                    mesh.cylinder(a + (0, 0, z), b + (0, 0, z), 0.02, 0.02, "metal_dark", 6, caps=False)
                for f in np.linspace(0.1, 0.9, 9):
                    p = a * (1 - f) + b * f
                    mesh.cylinder(p + (0, 0, 0.18), p + (0, 0, 1.0), 0.009, 0.009, "metal_dark", 5, caps=False)
            mesh.cylinder(posts[-1] - (0, 0, 0.05), posts[-1] + (0, 0, 1.05), 0.03, 0.03, "metal_dark", 8)
    stage.add("railings", mesh)


def _wires(stage, rng):
    """Across the street, each with a lamp in the middle."""
    mesh = Mesh()
    for s in WIRES_S:
        a = np.array(road.point(s, road.FACADE_T, 7.4))
        b = np.array(road.point(s + rng.uniform(-1, 1), -road.FACADE_T, 7.2))
        sag = lambda f: a * (1 - f) + b * f - np.array([0, 0, 2.0 * f * (1 - f)])
        mesh.tube([sag(f) for f in np.linspace(0, 1, 11)], 0.012, "metal_dark", 5)
        mesh.cylinder(sag(0.5) - (0, 0, 0.35), sag(0.5), 0.22, 0.06, "metal_grey", 14)
    stage.add("wires", mesh)


def _column(rng):
    mesh, radius, sides = Mesh(), 0.55, 24
    mesh.cylinder((0, 0, -0.1), (0, 0, 0.45), 0.66, 0.62, "concrete", sides)
    mesh.cylinder((0, 0, 2.75), (0, 0, 2.95), 0.68, 0.68, "wood_green", sides)
    mesh.cylinder((0, 0, 2.95), (0, 0, 3.35), 0.66, 0.12, "wood_green", sides)
    posters = [rng.randrange(POSTERS) for _ in range(4)]
    for k in range(sides):
        a, b = (2 * math.pi * (k + e) / sides for e in (0, 1))
        u0, u1 = k % 6 / 6, (k % 6 + 1) / 6
        around = [(radius * math.cos(w), radius * math.sin(w)) for w in (a, b)]
        mesh.polygon(
            [(*around[0], 0.45), (*around[1], 0.45), (*around[1], 2.75), (*around[0], 2.75)],
            f"poster{posters[k // 6]}",
            [(u0, 0), (u1, 0), (u1, 1), (u0, 1)],
            smooth=True,
        )
    return mesh


def _shelter():
    mesh = Mesh()
    for x, y in ((-1.9, -0.6), (0, -0.6), (1.9, -0.6), (-1.9, 0.5), (1.9, 0.5)):
        mesh.cylinder((x, y, 0), (x, y, 2.4), 0.035, 0.035, "metal_dark", 8)
    mesh.box(-2.1, 2.1, -0.75, 0.75, 2.4, 2.5, "metal_grey")
    mesh.box(1.86, 1.92, -0.5, 0.45, 0.4, 2.2, "metal_dark")
    for x in (1.855, 1.925):
        mesh.quad((x, -0.5, 0.4), (x, 0.45, 0.4), (x, 0.45, 2.2), (x, -0.5, 2.2), "poster8", UNIT_UV)
    for xa, poster in ((0.1, "poster1"), (-1.7, "poster2")):
        mesh.quad((xa, -0.62, 0.5), (xa + 1.4, -0.62, 0.5), (xa + 1.4, -0.62, 2.2), (xa, -0.62, 2.2), poster, UNIT_UV)
    mesh.box(-1.6, 0.9, -0.5, -0.1, 0.42, 0.48, "wood_brown")
    return mesh


def build(stage, settings, end):
    rng = settings.rng("furniture")
    lamp = _lamp().data("lamp", stage.materials)
    for side in (1, -1):
        for s in np.arange(-35 + (9 if side > 0 else 0), end - 40, 21.0):
            if not near_crossing(s, -3):
                stage.place("lamp", lamp, road.side_frame(side, s, KERB_T + 0.45))
    for sign in SIGNS:
        _sign(stage, *sign)
    _pavement_things(stage, rng, end)
    _railings(stage)
    _wires(stage, rng)
    for s, side in COLUMNS:
        stage.add("column", _column(rng), road.frame(s, side * (KERB_T + 1.25)))
    stage.add("shelter", _shelter(), road.frame(48, -(KERB_T + 1.5)))
