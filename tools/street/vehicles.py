# SPDX-License-Identifier: Apache-2.0
"""Cars as lofted bodies, parked along the kerbs; the traffic variant's three vehicles; the ego vehicle's bonnet.

Local frame of a car: origin on the ground below its middle, x ahead, y left, z up. Profiles below run from the front
bumper (0) to the rear.
"""
import math
from dataclasses import dataclass

import numpy as np

import road
from ground import near_crossing
from mesh import Mesh
from traffic import BOUNDS, COLORS, PARKED_T, RESERVED_S, TRAFFIC

EGO_COLOR = (0.04, 0.07, 0.13)


@dataclass(frozen=True)
class Shape:
    length: float
    deck: tuple  # (x, height) of bonnet, belt line, boot
    sill: tuple  # (x, height) of the lower edge
    half_width: tuple  # (x, metres)
    cabin: tuple  # (x, height) from the windscreen's foot over the roof to the rear window's foot
    roof: tuple  # x of the roof's front and rear edge
    roof_half_width: float
    pillars: tuple  # x of the pillars between the side windows
    side_glass: tuple  # x from, to
    axles: tuple
    wheel_radius: float


# fmt: off
SHAPES = {
    "sedan": Shape(
        length=4.55,
        deck=((0, 0.5), (0.08, 0.64), (0.4, 0.74), (1.2, 0.87), (1.6, 0.91), (2.6, 0.94), (3.6, 0.97), (4.1, 0.98),
              (4.42, 0.95), (4.55, 0.74)),
        sill=((0, 0.34), (0.2, 0.23), (0.6, 0.19), (3.9, 0.19), (4.35, 0.25), (4.55, 0.36)),
        half_width=((0, 0.6), (0.08, 0.71), (0.35, 0.81), (0.8, 0.87), (2.2, 0.89), (3.7, 0.87), (4.3, 0.8),
                    (4.5, 0.72), (4.55, 0.66)),
        cabin=((1.15, 0.86), (1.95, 1.34), (2.35, 1.43), (2.9, 1.44), (3.3, 1.39), (4.02, 1)),
        roof=(1.93, 3.32), roof_half_width=0.61, pillars=(2.42, 3.22), side_glass=(1.62, 3.62),
        axles=(0.8, 3.7), wheel_radius=0.31),
    "hatch": Shape(
        length=3.95,
        deck=((0, 0.52), (0.08, 0.67), (0.35, 0.78), (1, 0.91), (1.5, 0.95), (3, 1), (3.7, 1.02), (3.88, 0.98),
              (3.95, 0.8)),
        sill=((0, 0.34), (0.2, 0.23), (0.5, 0.19), (3.4, 0.19), (3.75, 0.25), (3.95, 0.38)),
        half_width=((0, 0.6), (0.08, 0.7), (0.3, 0.79), (0.7, 0.85), (2, 0.86), (3.3, 0.85), (3.75, 0.79),
                    (3.9, 0.72), (3.95, 0.66)),
        cabin=((0.92, 0.9), (1.7, 1.4), (2.1, 1.48), (2.9, 1.48), (3.45, 1.41), (3.86, 1.03)),
        roof=(1.68, 3.43), roof_half_width=0.6, pillars=(2.28, 3.1), side_glass=(1.38, 3.55),
        axles=(0.74, 3.22), wheel_radius=0.3),
    "van": Shape(
        length=4.9,
        deck=((0, 0.6), (0.08, 0.8), (0.3, 0.96), (0.9, 1.1), (1.4, 1.14), (3, 1.16), (4.7, 1.16), (4.84, 1.12),
              (4.9, 1)),
        sill=((0, 0.36), (0.2, 0.25), (0.6, 0.21), (4.3, 0.21), (4.7, 0.27), (4.9, 0.36)),
        half_width=((0, 0.72), (0.08, 0.82), (0.3, 0.9), (0.8, 0.94), (2.5, 0.95), (4.4, 0.94), (4.8, 0.9),
                    (4.9, 0.86)),
        cabin=((0.62, 1.06), (1.5, 1.8), (1.9, 1.94), (3.2, 1.97), (4.6, 1.93), (4.86, 1.2)),
        roof=(1.48, 4.62), roof_half_width=0.76, pillars=(2.3,), side_glass=(1.15, 2.95),
        axles=(0.86, 4.05), wheel_radius=0.33),
}
# fmt: on


def _curve(stations, x):
    """Cubic Hermite interpolation with limited tangents, so that it never overshoots."""
    px, py = np.array(stations, float).T
    slope = np.diff(py) / np.diff(px)
    tangent = np.concatenate(
        [
            [slope[0]],
            np.where(slope[:-1] * slope[1:] > 0, 2 * slope[:-1] * slope[1:] / (slope[:-1] + slope[1:] + 1e-12), 0),
            [slope[-1]],
        ]
    )
    k = np.clip(np.searchsorted(px, x) - 1, 0, len(px) - 2)
    h = px[k + 1] - px[k]
    f = np.clip((x - px[k]) / h, 0, 1)
    return (
        (1 + 2 * f) * (1 - f) ** 2 * py[k]
        + f * (1 - f) ** 2 * h * tangent[k]
        + f * f * (3 - 2 * f) * py[k + 1]
        - f * f * (1 - f) * h * tangent[k + 1]
    )


def _section(shape, x):
    """Returns half a cross section from the floor's middle to the roof's: [13, 2] of y, z."""
    w, deck, sill = (_curve(c, x) for c in (shape.half_width, shape.deck, shape.sill))
    foot, rear = shape.cabin[0][0], shape.cabin[-1][0]
    top, top_w = deck + 0.03, 0.88 * w
    if foot < x < rear:
        top = max(top, float(_curve(shape.cabin, x)))
        height = max(p[1] for p in shape.cabin) - deck
        top_w += (shape.roof_half_width - top_w) * min(1, (top - deck) / height)
    drop = min(0.06, 0.4 * (top - deck))
    belt, edge = np.array([0.925 * w, deck]), np.array([top_w, top - drop])
    side = lambda f: tuple(
        belt * (1 - f) + edge * f + np.array([0.02 * f * (1 - f) * 4 * min(1, (top - deck) / 0.4), 0])
    )
    return [
        (0, sill),
        (0.88 * w, sill),
        (0.97 * w, sill + 0.07),
        (w, sill + 0.45 * (deck - sill)),
        (0.995 * w, deck - 0.14),
        (0.97 * w, deck - 0.035),
        (0.935 * w, deck - 0.002),
        side(0.07),
        side(0.5),
        side(0.93),
        (0.92 * top_w, top - 0.25 * drop),
        (0.5 * top_w, top - 0.003),
        (0, top),
    ]


def _body(mesh, shape):
    glass_edges = [
        *shape.roof,
        *shape.side_glass,
        shape.cabin[0][0],
        shape.cabin[-1][0],
        shape.cabin[0][0] + 0.06,
        shape.cabin[-1][0] - 0.06,
    ]
    glass_edges += [p + e for p in shape.pillars for e in (-0.04, 0.04)]
    xs = sorted(
        {round(float(x), 4) for x in (*np.linspace(0, shape.length, 44), 0.04, shape.length - 0.03, *glass_edges)}
    )
    rings = []
    for x in xs:
        half = _section(shape, x)
        ahead = shape.length / 2 - x
        rings.append([(ahead, y, z) for y, z in half] + [(ahead, -y, z) for y, z in half[-2:0:-1]])
    count = len(rings[0])

    def material(x, j):
        j = min(j, count - 1 - j)  # the same on both sides
        in_pillar = any(abs(x - p) < 0.04 for p in shape.pillars)
        if j in (7, 8) and shape.side_glass[0] < x < shape.side_glass[1] and not in_pillar:
            return "carglass"
        screen = shape.cabin[0][0] + 0.06 < x < shape.roof[0] or shape.roof[1] < x < shape.cabin[-1][0] - 0.06
        if j in (10, 11) and screen:
            return "carglass"
        return "carplastic" if j in (0, 1) else "carpaint"

    for (xa, a), (xb, b) in zip(zip(xs[:-1], rings[:-1]), zip(xs[1:], rings[1:])):
        for j in range(count):
            n = (j + 1) % count
            mesh.polygon([a[j], b[j], b[n], a[n]], material((xa + xb) / 2, j), smooth=True)
    mesh.polygon(rings[0][::-1], "carpaint")
    mesh.polygon(rings[-1], "carpaint")


def _wheels(mesh, shape):
    r = shape.wheel_radius
    for axle in shape.axles:
        w = float(_curve(shape.half_width, axle))
        for side in (1, -1):
            hub = np.array([shape.length / 2 - axle, 0, r])
            disc = lambda inner, outer, radius, rim, material, sides=26: mesh.cylinder(
                hub + (0, side * inner, 0), hub + (0, side * outer, 0), radius, rim, material, sides
            )
            disc(w - 0.25, w + 0.006, r + 0.055, r + 0.05, "seam", 30)
            disc(w - 0.2, w + 0.018, r, r - 0.012, "tyre", 30)
            disc(w - 0.2, w + 0.024, r * 0.68, r * 0.64, "alloy")
            disc(w, w + 0.030, r * 0.16, r * 0.14, "carplastic", 10)
            for k in range(5):
                a = 2 * math.pi * k / 5 + 0.3
                at = hub + (r * 0.41 * math.cos(a), side * (w + 0.012), r * 0.41 * math.sin(a))
                mesh.cylinder(at, at + (0, side * 0.0145, 0), r * 0.14, r * 0.14, "seam", 8)


def _details(mesh, shape):
    length, front = shape.length, lambda x: shape.length / 2 - x
    width = lambda x: float(_curve(shape.half_width, x))
    deck = lambda x: float(_curve(shape.deck, x))
    both = lambda x0, x1, y0, y1, z0, z1, material: [
        mesh.box(front(x1), front(x0), min(s * y0, s * y1), max(s * y0, s * y1), z0, z1, material) for s in (1, -1)
    ]
    for x in (shape.side_glass[0] + 0.02, *shape.pillars):  # door gaps, handles
        if x < length - 0.6:
            both(x - 0.005, x + 0.005, width(x) - 0.03, width(x) + 0.003, 0.32, deck(x) - 0.08, "seam")
            both(x + 0.06, x + 0.24, width(x) - 0.04, width(x) + 0.018, deck(x) - 0.17, deck(x) - 0.14, "carplastic")
    both(1.2, length - 1.3, width(2.2) - 0.1, width(2.2) + 0.004, 0.19, 0.29, "carplastic")
    mirror = shape.cabin[0][0] + 0.62
    both(
        mirror - 0.07,
        mirror + 0.07,
        width(mirror) - 0.06,
        width(mirror) + 0.16,
        deck(mirror) + 0.04,
        deck(mirror) + 0.19,
        "carpaint",
    )
    lamp_z, w0 = deck(0.15) - 0.02, width(0.15)
    both(0.02, 0.24, w0 - 0.34, w0 - 0.03, lamp_z - 0.16, lamp_z - 0.03, "lamp_white")
    both(0.05, 0.26, w0 - 0.06, w0 + 0.012, lamp_z - 0.15, lamp_z - 0.05, "lamp_amber")
    lamp_z, w1 = deck(length - 0.15) - 0.04, width(length - 0.12)
    both(length - 0.2, length + 0.012, w1 - 0.22, w1 + 0.005, lamp_z - 0.28, lamp_z - 0.05, "lamp_red")
    box = lambda x0, x1, y, z0, z1, material: mesh.box(front(x1), front(x0), -y, y, z0, z1, material)
    box(-0.03, 0.06, 0.60, 0.25, 0.40, "carplastic")
    box(length - 0.1, length + 0.03, 0.66, 0.30, 0.46, "carplastic")
    for k in range(5):  # grille
        box(-0.012, 0.05, 0.40, 0.445 + 0.03 * k, 0.46 + 0.03 * k, "seam")
    box(-0.045, -0.03, 0.26, 0.30, 0.41, "plate")
    box(length + 0.02, length + 0.035, 0.26, 0.52, 0.63, "plate")


def _car(kind):
    mesh = Mesh()
    shape = SHAPES[kind]
    _body(mesh, shape)
    _wheels(mesh, shape)
    _details(mesh, shape)
    vertices = np.array(mesh.vertices)
    for found, said in (
        (vertices.max(0), BOUNDS[kind][1]),
        (np.maximum(vertices.min(0), (-9, -9, 0)), BOUNDS[kind][0]),
    ):
        assert np.allclose(found, said, atol=2e-3), f"BOUNDS of {kind}: {found}"
    return mesh


def _plate_text(stage, rng, world_from_car, kind):
    letters = "".join(rng.choice("ABCDEFGHJKLMNPRSTUVXYZ") for _ in range(3))
    rear = np.eye(4)  # a frame whose y axis points out of the car's rear
    rear[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    return stage.text(
        f"{letters}-{rng.randrange(100, 999)}",
        0.11,
        "sign_black",
        world_from_car @ rear,
        0,
        SHAPES[kind].length / 2 + 0.037,
        0.575,
    )


def _bonnet():
    """In the ego body's frame (origin below the rear axle), from the windscreen's foot to the bumper."""
    mesh = Mesh()
    xs, ys = np.linspace(2.15, 3.74, 12), np.linspace(-0.84, 0.84, 17)
    edge = lambda y: 1 - (y / 0.84) ** 2
    height = lambda x, y: (0.55 + 0.05 * math.sqrt(max(edge(y), 0)) + 0.012 * math.cos(5 * y)) + 0.13 * (
        1 - ((x - 2.15) / 1.6) ** 2
    )
    end = lambda x, y: 2.15 + (x - 2.15) * (0.90 + 0.10 * math.sqrt(max(edge(y), 0)))
    at = lambda x, y: (end(x, y), y, height(x, y))
    for xa, xb in zip(xs[:-1], xs[1:]):
        for ya, yb in zip(ys[:-1], ys[1:]):
            mesh.polygon([at(xa, ya), at(xb, ya), at(xb, yb), at(xa, yb)], "carpaint", smooth=True)
    for y in (-0.45, 0.45):  # seams of the wings
        for xa, xb in zip(xs[:-1], xs[1:]):
            lift = lambda x, dy: tuple(np.add(at(x, y + dy), (0, 0, 0.003)))
            mesh.polygon([lift(xa, -0.006), lift(xb, -0.006), lift(xb, 0.006), lift(xa, 0.006)], "seam")
    return mesh


def build(stage, settings, end):
    """Static parked cars; hidden: objects "traffic_<id>" and "ego bonnet", which the renderer places."""
    rng = settings.rng("cars")
    meshes = {kind: _car(kind).data(f"car {kind}", stage.materials, weld=True) for kind in SHAPES}
    color = 0
    for side in (1, -1):
        for s in np.arange(-34 + 6.2, end - 75, 6.2):
            if near_crossing(s, 1.5) or rng.random() < 0.26 or (side < 0 and abs(s - 48) < 5):
                continue
            kind = rng.choice(["sedan", "sedan", "hatch", "hatch", "van"])
            against = (side > 0) != (rng.random() < 0.12)
            world_from_local = road.frame(
                s + rng.uniform(-0.3, 0.3),
                side * (PARKED_T + rng.uniform(-0.07, 0.1)),
                turn=(math.pi if against else 0) + rng.uniform(-0.025, 0.025),
            )
            if side < 0 and RESERVED_S[0] - 2 < s < RESERVED_S[1] + 2:
                continue
            stage.place(f"car {kind}", meshes[kind], world_from_local, COLORS[color % len(COLORS)])
            _plate_text(stage, rng, world_from_local, kind)
            color += 1
    for vehicle in TRAFFIC:
        item = stage.place(
            f"traffic_{vehicle.object_id}", meshes[vehicle.kind], vehicle.world_from_car(0.0), vehicle.color
        )
        plate = _plate_text(stage, rng, vehicle.world_from_car(0.0), vehicle.kind)
        plate.name = f"traffic_{vehicle.object_id}_plate"
        plate.parent = item
        plate.matrix_parent_inverse = item.matrix_world.inverted()
    stage.place("ego bonnet", _bonnet().data("ego bonnet", stage.materials, weld=True), color=EGO_COLOR)
