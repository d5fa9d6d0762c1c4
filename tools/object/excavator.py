# SPDX-License-Identifier: Apache-2.0
"""The excavator, its base plate and the gears beside it, in units of the scene."""
import math
import random

from mathutils import Matrix, Vector

def turn(axis, degrees):
    return Matrix.Rotation(math.radians(degrees), 4, axis)


def move(x, y, z):
    return Matrix.Translation((x, y, z))


def ground(parts):
    """The base plate with all its studs, a kerb of small bricks and loose parts."""
    rng, pitch = random.Random(3), 0.1
    parts.box("sand", (-0.95, -0.75, -0.66), (0.95, 0.75, -0.6), 0.006)
    for i in range(19):
        for j in range(15):
            parts.stud("sand", -0.9 + i * pitch, -0.7 + j * pitch, -0.6, pitch)
    with parts.transformed(move(-0.95, -0.75, -0.6)):
        colours = ["red", "blue", "green", "white", "orange"]
        for i in range(0, 19, 2):
            n = 2 if i < 18 else 1
            for layer in range(rng.choice([1, 1, 2, 3])):
                parts.brick(rng.choice(colours), i, 14, 0.04 * layer, n, 1, pitch, 0.04)
        for _ in range(14):
            i, j = rng.choice([0, 1, 16, 17]), rng.randrange(1, 12)
            parts.brick(rng.choice(colours), i, j, 0.0, 1, rng.choice([1, 2]), pitch, 0.045)
    for k in range(9):  # a chain across the front
        with parts.transformed(move(0.72, -0.55 + 0.05 * k, -0.565) @ turn("X", 90 * (k % 2)) @ turn("Y", 12)):
            parts.ring("chrome", (0, 0, 0), (0, 0, 1), 0.032, 0.007, 24, 8)


def track(parts, y):
    """A crawler track around two sprockets and five rollers."""
    length, radius, links = 0.86, 0.17, 44
    half = length / 2 - radius
    around = 4 * half + 2 * math.pi * radius
    for k in range(links):
        s = around * k / links
        if s < 2 * half:
            p, angle = (-half + s, radius), 0
        elif s < 2 * half + math.pi * radius:
            w = (s - 2 * half) / radius
            p, angle = (half + radius * math.sin(w), radius * math.cos(w)), -w
        elif s < 4 * half + math.pi * radius:
            p, angle = (half - (s - 2 * half - math.pi * radius), -radius), -math.pi
        else:
            w = (s - 4 * half - math.pi * radius) / radius
            p, angle = (-half - radius * math.sin(w), -radius * math.cos(w)), -math.pi - w
        with parts.transformed(move(p[0], y, p[1] - 0.41) @ Matrix.Rotation(-angle, 4, "Y")):
            parts.box("dark", (-0.022, -0.1, -0.006), (0.022, 0.1, 0.01), 0.003)
            parts.box("dark", (-0.006, -0.1, 0.01), (0.006, 0.1, 0.026), 0.002)
            for v in (-0.06, 0.06):
                parts.cylinder("grey", (-0.024, v, 0.002), (0.024, v, 0.002), 0.009, 10)
    for x in (-half, half):
        with parts.transformed(move(x, y, -0.41) @ turn("X", 90)):
            parts.gear("grey", 0.135, 18, 0.12)
    for k in range(5):
        x = (k - 2) * 0.11
        parts.cylinder("grey", (x, y - 0.07, -0.52), (x, y + 0.07, -0.52), 0.045, 24)
        parts.cylinder("brass", (x, y - 0.08, -0.52), (x, y + 0.08, -0.52), 0.016, 14)
    parts.box("grey", (-half, y - 0.05, -0.46), (half, y + 0.05, -0.36))


def deck(parts):
    """Turntable, engine housing of bricks with a grille, counterweight, railings and pipes."""
    parts.box("dark", (-0.3, -0.25, -0.42), (0.3, 0.25, -0.3))
    parts.cylinder("grey", (0, 0, -0.3), (0, 0, -0.25), 0.24, 48)
    for k in range(36):
        w = 2 * math.pi * k / 36
        with parts.transformed(turn("Z", 10 * k)):
            parts.box("grey", (0.235, -0.009, -0.295), (0.256, 0.009, -0.26), 0.002)
    parts.box("yellow", (-0.6, -0.36, -0.25), (0.36, 0.36, -0.19), 0.006)
    pitch = 0.08
    with parts.transformed(move(-0.56, -0.32, -0.19)):
        rows = ["yellow", "yellow", "orange", "yellow"]
        for layer, colour in enumerate(rows):
            top = layer == len(rows) - 1
            for j in range(0, 8, 2):
                shift = layer % 2
                for i in range(0, 6, 2):
                    n = 2 if not (shift and i == 4) else 1
                    parts.brick(colour, i + shift, j, 0.065 * layer, n, 2, pitch, 0.065, studs=top)
                if shift:
                    parts.brick(colour, 0, j, 0.065 * layer, 1, 2, pitch, 0.065, studs=top)
    for k in range(13):  # grille on both sides
        for side in (-1, 1):
            x = -0.52 + 0.033 * k
            with parts.transformed(move(x, side * 0.325, -0.06) @ turn("Z", side * 20)):
                parts.box("dark", (-0.012, -0.006, -0.1), (0.012, 0.006, 0.1), 0.002)
    with parts.transformed(move(-0.64, 0, -0.06)):  # counterweight
        outline = [(-0.13 + 0.13 * (1 - math.cos(w)), 0.36 * math.sin(w) / math.sin(1.2)) for w in [1.2 - 0.1 * k for k in range(25)]]
        outline = [(x, y) for x, y in outline][::-1] + [(0.06, -0.36), (0.06, 0.36)]
        area = sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(outline, outline[1:] + outline[:1]))
        parts.prism("grey", outline if area > 0 else outline[::-1], -0.16, 0.14)
        for k in range(9):
            with parts.transformed(turn("Z", 0)):
                y = -0.3 + 0.075 * k
                parts.box("yellow" if k % 2 else "dark", (-0.165, y, -0.03), (-0.05, y + 0.04, 0.0), 0.002)
    for x, y, h in ((-0.42, 0.2, 0.2), (-0.42, 0.12, 0.16)):  # exhausts
        parts.cylinder("chrome", (x, y, 0.08), (x, y, 0.08 + h), 0.028, 24)
        parts.ring("chrome", (x, y, 0.08 + h), (0, 0, 1), 0.026, 0.006)
        parts.cylinder("dark", (x, y, 0.08 + h - 0.004), (x, y, 0.08 + h + 0.001), 0.022, 20)
    for y in (-0.34, 0.34):  # railings: thin rods
        posts = [-0.56 + 0.13 * k for k in range(5)]
        for x in posts:
            parts.cylinder("chrome", (x, y, -0.19), (x, y, 0.2), 0.007, 10)
        for z in (0.06, 0.13, 0.2):
            parts.cylinder("chrome", (posts[0], y, z), (posts[-1], y, z), 0.006, 10)
    for k in range(4):  # pipes over the deck
        y = -0.26 + 0.03 * k
        parts.cylinder("brass" if k % 2 else "chrome", (-0.1, y, -0.16), (0.3, y, -0.16), 0.009, 10)
    for p, q in (((-0.5, -0.28, 0.07), (-0.62, -0.34, 0.78)), ((-0.5, 0.28, 0.07), (-0.56, 0.3, 0.66))):  # whip antennas
        parts.cylinder("dark", p, q, 0.006, 8, 0.003)
        parts.cylinder("red", q, (q[0], q[1], q[2] + 0.025), 0.012, 12)
        parts.ring("dark", p, (0, 0, 1), 0.014, 0.006, 20, 8)


def cabin(parts):
    low, high = Vector((0.02, 0.06, -0.19)), Vector((0.34, 0.34, 0.36))
    parts.box("glass", low + Vector((0.02, 0.02, 0.02)), high - Vector((0.02, 0.02, 0.02)), 0.01)
    for x in (low.x, high.x - 0.035):
        for y in (low.y, high.y - 0.035):
            parts.box("yellow", (x, y, low.z), (x + 0.035, y + 0.035, high.z))
    for z in (low.z, -0.02, high.z - 0.04):
        parts.box("yellow", (low.x, low.y, z), (high.x, low.y + 0.03, z + 0.04))
        parts.box("yellow", (low.x, high.y - 0.03, z), (high.x, high.y, z + 0.04))
        parts.box("yellow", (low.x, low.y, z), (low.x + 0.03, high.y, z + 0.04))
        parts.box("yellow", (high.x - 0.03, low.y, z), (high.x, high.y, z + 0.04))
    parts.box("white", (low.x - 0.02, low.y - 0.02, high.z), (high.x + 0.02, high.y + 0.02, high.z + 0.03))
    for a in range(4):
        for b in range(3):
            parts.stud("white", low.x + 0.04 + 0.08 * a, low.y + 0.06 + 0.08 * b, high.z + 0.03, 0.08)
    parts.cylinder("orange", (0.08, 0.31, high.z + 0.03), (0.08, 0.31, high.z + 0.1), 0.028, 20, 0.018)  # beacon
    for y in (0.1, 0.3):  # lamps
        parts.cylinder("grey", (high.x, y, 0.4), (high.x + 0.04, y, 0.4), 0.026, 20)
        parts.cylinder("white", (high.x + 0.04, y, 0.4), (high.x + 0.045, y, 0.4), 0.021, 20)
    for z in (-0.12, -0.06, 0.08, 0.14):  # ladder
        parts.cylinder("chrome", (0.06, 0.365, z), (0.3, 0.365, z), 0.007, 10)
    for x in (0.06, 0.3):
        parts.cylinder("chrome", (x, 0.365, -0.18), (x, 0.365, 0.3), 0.008, 10)
    for k in range(3):  # wiper and mirror arms
        parts.cylinder("dark", (high.x + 0.004, 0.14 + 0.03 * k, 0.0), (high.x + 0.004, 0.2 + 0.03 * k, 0.22), 0.004, 8)


def piston(parts, p, q, radius):
    p, q = Vector(p), Vector(q)
    middle = p + 0.55 * (q - p)
    parts.cylinder("grey", p, middle, radius, 24)
    parts.cylinder("chrome", middle, q, 0.5 * radius, 20)
    for at, r in ((p, 1.25), (middle, 1.15), (q, 1.1)):
        parts.cylinder("dark", at - Vector((0, 1.4 * radius, 0)), at + Vector((0, 1.4 * radius, 0)), r * 0.6 * radius, 16)
    parts.ring("brass", middle, q - p, radius, 0.2 * radius)


def beam(parts, p, q, thick0, thick1, width, colour, stripes):
    """A tapered box beam in the plane y = const, with rivets, warning stripes and side plates."""
    p, q = Vector(p), Vector(q)
    along = (q - p).normalized()
    up = Vector((-along.z, 0, along.x))
    for side in (-1, 1):
        y = p.y + side * width / 2
        corners = [p - up * thick0, q - up * thick1, q + up * thick1, p + up * thick0]
        points = [(c.x, y + d * 0.008, c.z) for d in (-1, 1) for c in corners]
        parts.add(colour, points, [(0, 1, 2, 3), (7, 6, 5, 4), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)])
        n = int((q - p).length / 0.035)
        for k in range(1, n):
            c = p + (q - p) * (k / n)
            t = thick0 + (thick1 - thick0) * k / n
            for s in (-0.75, 0.75):
                d = c + up * (s * t)
                parts.cylinder("chrome", (d.x, y + side * 0.008, d.z), (d.x, y + side * 0.014, d.z), 0.0065, 10)
        for k in range(stripes):
            a, b = p + (q - p) * (0.3 + 0.4 * k / stripes), p + (q - p) * (0.3 + 0.4 * (k + 0.5) / stripes)
            lean = 0.02 * along
            quad = [a - up * 0.03 - lean, b - up * 0.03 - lean, b + up * 0.03 + lean, a + up * 0.03 + lean]
            face = [(c.x, y + side * 0.0085, c.z) for c in quad]
            parts.add("dark", face, [(0, 1, 2, 3)])
    n = int((q - p).length / 0.05)
    for k in range(n):  # open lattice above and below
        a, b = p + (q - p) * (k / n), p + (q - p) * ((k + 1) / n)
        for s in (-0.85, 0.85):
            y0, y1 = (p.y - width / 2, p.y + width / 2) if k % 2 else (p.y + width / 2, p.y - width / 2)
            c, d = a + up * (s * (thick0 + (thick1 - thick0) * k / n)), b + up * (s * (thick0 + (thick1 - thick0) * (k + 1) / n))
            parts.cylinder("dark", (c.x, y0, c.z), (d.x, y1, d.z), 0.008, 10)


def arm(parts):
    y = -0.14
    foot, elbow, wrist = (0.3, y, -0.16), (0.72, y, 0.66), (1.02, y, 0.02)
    beam(parts, foot, elbow, 0.08, 0.055, 0.13, "yellow", 7)
    beam(parts, elbow, wrist, 0.06, 0.04, 0.1, "orange", 4)
    for at, r in ((foot, 0.07), (elbow, 0.06), (wrist, 0.045)):
        parts.cylinder("dark", (at[0], y - 0.1, at[2]), (at[0], y + 0.1, at[2]), r, 28)
        parts.cylinder("chrome", (at[0], y - 0.115, at[2]), (at[0], y + 0.115, at[2]), 0.4 * r, 20)
    for d in (-0.1, 0.1):
        piston(parts, (0.1, y + d, -0.14), (0.44, y + d, 0.22), 0.03)
    piston(parts, (0.42, y, 0.36), (0.66, y, 0.78), 0.026)
    piston(parts, (0.86, y, 0.56), (1.06, y, 0.12), 0.022)
    for k in range(3):  # hoses: thin arcs over the elbow
        points = []
        for i in range(15):
            w = math.pi * (0.15 + 0.75 * i / 14)
            points.append((0.74 - 0.22 * math.cos(w), y + 0.03 * (k - 1), 0.58 + (0.2 + 0.015 * k) * math.sin(w)))
        for a, b in zip(points, points[1:]):
            parts.cylinder("dark", a, b, 0.008, 8)
    # The bucket: a bent plate between two cheeks, with teeth.
    with parts.transformed(move(1.02, y, 0.0)):
        arc = [(0.17 * math.cos(w) - 0.08, -0.17 + 0.16 * math.sin(w)) for w in [0.5 - 0.22 * k for k in range(19)]]
        inner = [(0.93 * x - 0.005, 0.93 * z - 0.012) for x, z in arc]
        for (a, b), (c, d) in zip(zip(arc, arc[1:]), zip(inner, inner[1:])):
            for outside, (u, v) in ((True, (a, b)), (False, (c, d))):
                quad = [(u[0], -0.14, u[1]), (v[0], -0.14, v[1]), (v[0], 0.14, v[1]), (u[0], 0.14, u[1])]
                parts.add("grey", quad, [(0, 1, 2, 3)], True)
        for side in (-0.14, 0.14):
            points = [(x, side, z) for x, z in arc]
            parts.add("grey", points, [tuple(range(len(points)))])
        x, z = arc[-1]
        for k in range(6):
            v = -0.125 + 0.05 * k
            with parts.transformed(move(x, v, z) @ turn("Y", -35)):
                parts.box("chrome", (-0.06, -0.012, -0.008), (0.03, 0.012, 0.008), 0.003)


def gears(parts):
    """Three meshing gears on a wall of bricks behind the kerb, brass, red and blue."""
    with parts.transformed(move(-0.2, -0.56, -0.42) @ turn("X", 90)):
        with parts.transformed(move(-0.3, 0, 0)):
            parts.gear("red", 0.15, 20, 0.05)
        with parts.transformed(move(0.02, 0.04, 0) @ turn("Z", 4)):
            parts.gear("brass", 0.16, 22, 0.05)
        with parts.transformed(move(0.29, -0.05, 0) @ turn("Z", 9)):
            parts.gear("blue", 0.105, 14, 0.05)
    pitch = 0.08
    with parts.transformed(move(-0.64, -0.53, -0.6)):
        rng = random.Random(5)
        for layer in range(5):
            i = 0
            while i < 11:
                n = min(rng.choice([1, 2, 2, 3]), 11 - i)
                parts.brick(rng.choice(["white", "green", "grey", "white"]), i, 0, 0.06 * layer, n, 1, pitch, 0.06, studs=layer == 4)
                i += n
