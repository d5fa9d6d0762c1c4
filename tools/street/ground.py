# SPDX-License-Identifier: Apache-2.0
"""Carriageway, kerbs, pavements, markings, patches, manholes, gravel."""
import math

import numpy as np

import road
from mesh import Mesh
from road import KERB_T, LANE_EDGE_T, LANE_T, ground_point

CROSSING_S = (55.0, 58.5)
NO_MARKS_S = (51.0, 62.0)  # around the crossing
_CUTS_T = (-KERB_T, -LANE_EDGE_T, -LANE_T, 0.0, LANE_T, LANE_EDGE_T, KERB_T)


def near_crossing(s, margin=0.0):
    return NO_MARKS_S[0] - margin < s < NO_MARKS_S[1] + margin


def _surface(stage, end):
    mesh = Mesh()
    for s in range(road.START_S, end):
        for a, b in zip(_CUTS_T[:-1], _CUTS_T[1:]):
            lane = abs(a + b) / 2 < LANE_EDGE_T
            mesh.polygon(
                [ground_point(s, a), ground_point(s + 1, a), ground_point(s + 1, b), ground_point(s, b)],
                "asphalt" if lane else "asphalt_old",
                [(s, a), (s + 1, a), (s + 1, b), (s, b)],
                smooth=True,
            )
        for side in (1, -1):
            face, back, end_t, top = side * KERB_T, side * (KERB_T + 0.16), side * 14.0, 0.02
            strips = (
                (face, road.cross_z(face), face, top, "kerb", 0.1),
                (face, top, back, top, "kerb", 0.25),
                (back, top, end_t, road.cross_z(end_t), "slabs", 0.0),
            )
            for ta, za, tb, zb, material, v in strips:
                v1 = v + abs(tb - ta) + abs(zb - za)
                points = [
                    road.point(s, ta, za),
                    road.point(s + 1, ta, za),
                    road.point(s + 1, tb, zb),
                    road.point(s, tb, zb),
                ]
                uvs = [(s + 0.03, v), (s + 1.03, v), (s + 1.03, v1), (s + 0.03, v1)]
                mesh.polygon(points[::side], material, uvs[::side])
    stage.add("ground", mesh)
    plate = Mesh()
    plate.quad((-400, -400, -0.9), (end + 400, -400, -0.9), (end + 400, 400, -0.9), (-400, 400, -0.9), "concrete")
    stage.add("plate", plate)


def _sheet(mesh, s0, s1, t0, t1, material, lift=0.004):
    """Adds a thin layer on the road that follows its bend and camber."""
    t0, t1 = min(t0, t1), max(t0, t1)
    pieces = max(1, math.ceil(s1 - s0))
    across = sorted({t0, t1} | {t for t in _CUTS_T if t0 < t < t1})
    along = np.linspace(s0, s1, pieces + 1)
    for a, b in zip(along[:-1], along[1:]):
        for c, d in zip(across[:-1], across[1:]):
            mesh.polygon(
                [
                    ground_point(a, c, lift),
                    ground_point(b, c, lift),
                    ground_point(b, d, lift),
                    ground_point(a, d, lift),
                ],
                material,
                [(a, c), (b, c), (b, d), (a, d)],
            )


def _arrow(mesh, s, t):
    for outline in (((0, -0.09), (3, -0.09), (3, 0.09), (0, 0.09)), ((3, -0.35), (4.4, 0), (3, 0.35))):
        mesh.polygon(
            [ground_point(s + ds, t + dt, 0.005) for ds, dt in outline],
            "paint",
            [(s + ds, t + dt) for ds, dt in outline],
        )


def _markings(stage, end, rng):
    mesh = Mesh()
    for s in np.arange(road.START_S + 10, end - 10, 6.0):
        if not near_crossing(s):
            _sheet(mesh, s, s + 3.0, -0.06, 0.06, "paint")
    for a, b in ((road.START_S + 5, 52), (62, end - 10)):
        for side in (-1, 1):
            _sheet(mesh, a, b, side * 3.24, side * 3.36, "paint")
    for s in np.arange(road.START_S + 10, end - 15, 6.2):
        for side in (-1, 1):
            if not near_crossing(s, 1):
                _sheet(mesh, s, s + 0.1, side * 3.36, side * 5.3, "paint")  # parking bays
    for k in range(10):
        _sheet(mesh, *CROSSING_S, -5.0 + 1.03 * k, -4.5 + 1.03 * k, "paint", 0.005)
    _sheet(mesh, 53.0, 53.4, -3.2, -0.1, "paint")
    _sheet(mesh, 60.2, 60.6, 0.1, 3.2, "paint")
    for s in (22.5, 46.0, 78.0):
        _arrow(mesh, s, -LANE_T)
    for k in range(34):  # repairs, one above the other
        s, t = rng.uniform(-30, 130), rng.uniform(-3.0, 2.4)
        _sheet(
            mesh,
            s,
            s + rng.uniform(0.8, 4.5),
            t,
            t + rng.uniform(0.5, 1.3),
            rng.choice(["asphalt_patch", "asphalt_patch", "asphalt_old"]),
            0.002 + 0.000025 * k,
        )
    for _ in range(14):  # manholes
        top = np.array(ground_point(rng.uniform(-20, 120), rng.choice([-2.4, -0.7, 0.8, 2.6]), 0.0062))
        for radius, lift, material in (
            (0.31, 0, "metal_dark"),
            (0.24, 0.002, "metal_grey"),
            (0.10, 0.004, "metal_dark"),
        ):
            mesh.cylinder(top - (0, 0, 0.05), top + (0, 0, lift), radius, radius, material, 20)
    for s in np.arange(-40, end - 80, 14.0):  # gullies
        for side in (-1, 1):
            _sheet(mesh, s, s + 0.5, side * 5.02, side * 5.42, "metal_dark")
    stage.add("markings", mesh)


def pebbles(mesh, rng, count, x, y, z, size=(0.012, 0.035)):
    """Scatters octahedra over the rectangle |x| by |y| at height z of a local frame."""
    for _ in range(count):
        c = np.array([rng.uniform(-x, x), rng.uniform(-y, y), z])
        r = [rng.uniform(*size) for _ in range(3)]
        material = rng.choice(["pebble_light", "pebble_dark"])
        tips = [c + (r[0], 0, 0), c + (0, r[1], 0), c - (r[0], 0, 0), c - (0, r[1], 0)]
        for k in range(4):
            mesh.polygon([tips[k], tips[(k + 1) % 4], c + (0, 0, r[2])], material, [(c[0], c[1])] * 3)


def build(stage, settings, end):
    _surface(stage, end)
    _markings(stage, end, settings.rng("markings"))
