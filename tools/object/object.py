# SPDX-License-Identifier: Apache-2.0
"""A toy excavator of plastic bricks, seen from all around: an object scene in the Blender format, for benchmarks.

    blender --background --python-exit-code 1 --python tools/object/object.py -- build/object

Everything is computed from a seed. Existing images are kept, so an interrupted run continues.
"""
import argparse
import json
import math
import os
import random
import sys
import time
from pathlib import Path

import bpy
from mathutils import Matrix, Vector

FOV_RAD = 0.6911112070083618  # field of view and distance of the well-known sets of this format
DISTANCE = 4.031128874149275
PLASTIC = {  # linear RGB, roughness, metallic
    "yellow": ((0.80, 0.42, 0.02), 0.22, 0),
    "orange": ((0.75, 0.16, 0.02), 0.25, 0),
    "red": ((0.50, 0.02, 0.02), 0.20, 0),
    "blue": ((0.02, 0.08, 0.40), 0.20, 0),
    "green": ((0.03, 0.22, 0.06), 0.30, 0),
    "sand": ((0.45, 0.35, 0.22), 0.45, 0),
    "white": ((0.75, 0.75, 0.72), 0.25, 0),
    "grey": ((0.20, 0.21, 0.22), 0.35, 0),
    "dark": ((0.035, 0.035, 0.04), 0.30, 0),
    "glass": ((0.01, 0.02, 0.03), 0.05, 0),
    "chrome": ((0.80, 0.80, 0.82), 0.18, 1),
    "brass": ((0.70, 0.48, 0.18), 0.25, 1),
}


class Parts:
    """Polygons by material, placed by a stack of transforms; become one Blender mesh a material."""

    def __init__(self):
        self.soup = {name: ([], [], []) for name in PLASTIC}  # vertices, faces, smooth
        self.at = Matrix.Identity(4)

    def transformed(self, matrix):
        return _Transformed(self, matrix)

    def add(self, material, points, faces, smooth=False):
        vertices, all_faces, all_smooth = self.soup[material]
        first = len(vertices)
        vertices += [tuple(self.at @ Vector(p)) for p in points]
        all_faces += [tuple(first + i for i in face) for face in faces]
        all_smooth += [smooth] * len(faces)

    def box(self, material, low, high, bevel=0.004):
        """A box whose edges are cut off by `bevel`: edges that catch the light."""
        low, high = Vector(low), Vector(high)
        b = min(bevel, 0.3 * min(high - low))
        corners = {}
        points = []
        for sx in (0, 1):
            for sy in (0, 1):
                for sz in (0, 1):
                    for axis in range(3):  # the corner on the face across `axis`
                        p = [(low, high)[s][k] + (1 - 2 * s) * (0 if k == axis else b) for k, s in enumerate((sx, sy, sz))]
                        corners[sx, sy, sz, axis] = len(points)
                        points.append(p)
        c, faces = corners, []
        center = 0.5 * (low + high)

        def face(*indices):
            p = [Vector(points[i]) for i in indices]
            normal, outward = (p[1] - p[0]).cross(p[2] - p[0]), sum(p, Vector()) / len(p) - center
            faces.append(indices if normal.dot(outward) > 0 else indices[::-1])

        def key(axis, s, u, v):
            k = [0, 0, 0]
            k[axis], k[(axis + 1) % 3], k[(axis + 2) % 3] = s, u, v
            return tuple(k)

        for axis in range(3):
            for s in (0, 1):
                face(*(c[(*key(axis, s, u, v), axis)] for u, v in ((0, 0), (1, 0), (1, 1), (0, 1))))
            u, v = (axis + 1) % 3, (axis + 2) % 3
            for su in (0, 1):
                for sv in (0, 1):  # the edge along `axis`
                    ends = [key(axis, s, su, sv) for s in (0, 1)]
                    face(c[(*ends[0], u)], c[(*ends[1], u)], c[(*ends[1], v)], c[(*ends[0], v)])
        for corner in [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]:
            face(*(c[(*corner, axis)] for axis in range(3)))
        self.add(material, points, faces)

    def cylinder(self, material, p0, p1, radius, sides=24, end_radius=None):
        p0, p1 = Vector(p0), Vector(p1)
        axis = (p1 - p0).normalized()
        a = axis.orthogonal().normalized()
        b = axis.cross(a)
        points = []
        for p, r in ((p0, radius), (p1, radius if end_radius is None else end_radius)):
            points += [p + r * (math.cos(w) * a + math.sin(w) * b) for w in (2 * math.pi * k / sides for k in range(sides))]
        self.add(material, points, [(k, (k + 1) % sides, sides + (k + 1) % sides, sides + k) for k in range(sides)], True)
        self.add(material, points, [tuple(range(sides))[::-1], tuple(range(sides, 2 * sides))])

    def ring(self, material, center, axis, radius, tube, sides=32, around=10):
        """A torus."""
        center, axis = Vector(center), Vector(axis).normalized()
        a = axis.orthogonal().normalized()
        b = axis.cross(a)
        points, faces = [], []
        for i in range(sides):
            w = 2 * math.pi * i / sides
            out = math.cos(w) * a + math.sin(w) * b
            for j in range(around):
                v = 2 * math.pi * j / around
                points.append(center + (radius + tube * math.cos(v)) * out + tube * math.sin(v) * axis)
                faces.append([((i + di) % sides) * around + (j + dj) % around for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1))])
        self.add(material, points, faces, True)

    def prism(self, material, outline, z0, z1):
        """A counter-clockwise outline in x, y, extruded; its side faces are flat."""
        n = len(outline)
        points = [(x, y, z) for z in (z0, z1) for x, y in outline]
        self.add(
            material,
            points,
            [(k, (k + 1) % n, n + (k + 1) % n, n + k) for k in range(n)] + [tuple(range(n))[::-1], tuple(range(n, 2 * n))],
        )

    def gear(self, material, radius, teeth, width, hole="dark"):
        """A spur gear around z with round holes' rims, spokes and an axle."""
        outline, tooth = [], 2 * math.pi / teeth
        depth = 2.0 * radius / teeth
        for k in range(teeth):
            for share, r in ((0, radius - depth), (0.25, radius - depth), (0.38, radius + depth), (0.62, radius + depth), (0.75, radius - depth)):
                w = (k + share) * tooth
                outline.append((r * math.cos(w), r * math.sin(w)))
        self.prism(material, outline, -width / 2, width / 2)
        for side in (-1, 1):
            z = side * width / 2
            self.ring(material, (0, 0, z), (0, 0, 1), 0.78 * radius, 0.06 * radius)
            self.cylinder(material, (0, 0, z), (0, 0, z + side * 0.02), 0.3 * radius)
            for k in range(6):
                w = 2 * math.pi * k / 6
                p = (0.54 * radius * math.cos(w), 0.54 * radius * math.sin(w))
                self.cylinder(hole, (*p, z), (*p, z + side * 0.001), 0.14 * radius)
                self.ring(material, (*p, z), (0, 0, 1), 0.14 * radius, 0.012 * radius + 0.002, 20, 6)
        self.box("dark", (-0.012, -0.036, -width), (0.012, 0.036, width), 0.002)
        self.box("dark", (-0.036, -0.012, -width), (0.036, 0.012, width), 0.002)

    def stud(self, material, x, y, z, pitch):
        r = 0.3 * pitch
        self.cylinder(material, (x, y, z), (x, y, z + 0.2 * pitch), r, 20)
        # Four raised strokes in place of a real stud's lettering.
        top = z + 0.2 * pitch
        for k in range(4):
            u, h = x + (k - 1.5) * 0.26 * r, 0.5 * r if k % 3 else 0.32 * r
            self.box(material, (u - 0.06 * r, y - h, top - 0.001), (u + 0.06 * r, y + h, top + 0.03 * pitch), 0.0005)

    def brick(self, material, i, j, z, nx, ny, pitch, height, studs=True):
        gap = 0.015 * pitch
        self.box(
            material, (i * pitch + gap, j * pitch + gap, z), ((i + nx) * pitch - gap, (j + ny) * pitch - gap, z + height - gap), 0.04 * pitch
        )
        if studs:
            for a in range(nx):
                for b in range(ny):
                    self.stud(material, (i + a + 0.5) * pitch, (j + b + 0.5) * pitch, z + height - gap, pitch)

    def build(self):
        for name, (vertices, faces, smooth) in self.soup.items():
            if not faces:
                continue
            mesh = bpy.data.meshes.new(name)
            mesh.from_pydata(vertices, [], faces)
            mesh.polygons.foreach_set("use_smooth", smooth)
            mesh.materials.append(material(name))
            mesh.update()
            bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, mesh))


class _Transformed:
    def __init__(self, parts, matrix):
        self.parts, self.matrix = parts, matrix

    def __enter__(self):
        self.before = self.parts.at
        self.parts.at = self.before @ self.matrix

    def __exit__(self, *_):
        self.parts.at = self.before


def material(name):
    """The sun by Blender's own shader; sky and ground as emission of normal and mirrored view, which costs no ray and has no noise."""
    if name in bpy.data.materials:
        return bpy.data.materials[name]
    color, roughness, metallic = PLASTIC[name]
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    tree = made.node_tree
    shader, out = tree.nodes["Principled BSDF"], tree.nodes["Material Output"]
    shader.inputs["Base Color"].default_value = (*color, 1)
    shader.inputs["Roughness"].default_value = roughness
    shader.inputs["Metallic"].default_value = metallic

    def node(kind, *inputs, **settings):
        new = tree.nodes.new(kind)
        for key, value in settings.items():
            setattr(new, key, value)
        for i, value in enumerate(inputs):
            if isinstance(value, bpy.types.NodeSocket):
                tree.links.new(value, new.inputs[i])
            else:
                new.inputs[i].default_value = value
        return new

    def scaled(vector, factor):
        return node("ShaderNodeVectorMath", vector, (0, 0, 0), (0, 0, 0), factor, operation="SCALE").outputs[0]

    def light_from(direction):
        """Interpolates between ground and sky by height."""
        z = node("ShaderNodeSeparateXYZ", direction).outputs[2]
        up = node("ShaderNodeMapRange", z, -1.0, 1.0, 0.0, 1.0).outputs[0]
        return node("ShaderNodeMixRGB", up, (0.14, 0.12, 0.10, 1), (0.60, 0.66, 0.72, 1)).outputs[0]

    seen = node("ShaderNodeNewGeometry").outputs
    normal, to_eye = seen["Normal"], seen["Incoming"]
    from_eye = scaled(to_eye, -1.0)
    mirrored = node("ShaderNodeVectorMath", from_eye, normal, operation="REFLECT").outputs[0]
    base = node("ShaderNodeRGB").outputs[0]
    base.default_value = (*color, 1)
    diffuse = node("ShaderNodeVectorMath", base, light_from(normal), operation="MULTIPLY").outputs[0]
    if metallic:
        glossy = node("ShaderNodeVectorMath", base, light_from(mirrored), operation="MULTIPLY").outputs[0]
    else:
        fresnel = node("ShaderNodeFresnel", 1.45).outputs[0]
        glossy = scaled(scaled(light_from(mirrored), fresnel), 1.0 - roughness)
    sum_ = glossy if metallic else node("ShaderNodeVectorMath", diffuse, glossy, operation="ADD").outputs[0]
    emission = node("ShaderNodeEmission", sum_, 1.0).outputs[0]
    tree.links.new(node("ShaderNodeAddShader", shader.outputs[0], emission).outputs[0], out.inputs["Surface"])
    if hasattr(made.cycles, "sample_as_light"):
        made.cycles.sample_as_light = False
    return made


def text(words, size, name, world_from_text):
    """Raised letters, legible from +z of their frame."""
    curve = bpy.data.curves.new("text", "FONT")
    curve.body, curve.size, curve.align_x, curve.align_y = words, size, "CENTER", "CENTER"
    curve.extrude, curve.bevel_depth, curve.resolution_u = 0.05 * size, 0.01 * size, 4
    curve.materials.append(material(name))
    item = bpy.data.objects.new("text", curve)
    item.matrix_world = world_from_text
    bpy.context.scene.collection.objects.link(item)


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


def make_scene():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    parts = Parts()
    with parts.transformed(move(-0.08, 0, 0.08)):
        ground(parts)
        for y in (-0.36, 0.36):
            with parts.transformed(move(-0.02, 0.0, 0.0)):
                track(parts, 0.9 * y)
        with parts.transformed(turn("Z", 0)):
            deck(parts)
            cabin(parts)
            arm(parts)
        gears(parts)
    parts.build()
    at = move(-0.08, 0, 0.08)
    text("REDRIVE 4", 0.13, "dark", at @ move(-0.32, 0.329, 0.035) @ turn("Z", 180) @ turn("X", 90))
    text("REDRIVE 4", 0.13, "dark", at @ move(-0.32, -0.329, 0.035) @ turn("X", 90))
    text("MAX 900 kg", 0.055, "white", at @ move(-0.6, 0.0, 0.085) @ turn("Z", 90))
    text("0123456789", 0.07, "red", at @ move(0.5, 0.55, -0.575))
    text("keep clear", 0.08, "blue", at @ move(0.55, 0.35, -0.575) @ turn("Z", 15))

    lamp = bpy.data.lights.new("sun", "SUN")
    lamp.energy, lamp.angle = 2.6, 0  # a point: its shadows have no noise
    sun = bpy.data.objects.new("sun", lamp)
    sun.matrix_world = turn("Z", 35) @ turn("X", 40)
    bpy.context.scene.collection.objects.link(sun)


def settings(size, threads):
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    c = scene.cycles
    c.device, c.use_denoising = "CPU", False
    c.use_adaptive_sampling, c.adaptive_threshold, c.adaptive_min_samples = True, 0.01, 8
    c.max_bounces = 0  # sky and ground are in the materials
    c.sample_clamp_direct = 4.0
    r = scene.render
    r.use_persistent_data, r.threads_mode, r.threads = True, "FIXED", threads
    r.resolution_x = r.resolution_y = size
    r.resolution_percentage = 100
    r.film_transparent = True
    r.image_settings.file_format, r.image_settings.color_mode, r.image_settings.color_depth = "PNG", "RGBA", "8"
    r.use_compositing = r.use_sequencer = False
    scene.view_settings.view_transform = "Standard"


def camera_poses(count, phase):
    """Returns world_from_camera with OpenGL axes, evenly over the upper hemisphere and a little below the horizon."""
    poses = []
    for k in range(count):
        z = -0.08 + 1.03 * (k + 0.5) / count
        w = 2.399963229728653 * k + phase
        r = math.sqrt(max(0.0, 1 - z * z))
        place = DISTANCE * Vector((r * math.cos(w), r * math.sin(w), z))
        poses.append(move(*place) @ place.to_track_quat("Z", "Y").to_matrix().to_4x4())
    return poses


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--train", type=int, default=100)
    parser.add_argument("--test", type=int, default=12)
    parser.add_argument("--size", type=int, default=800)
    parser.add_argument("--samples", type=int, default=16, help="light paths a pixel of a training image")
    parser.add_argument("--test-samples", type=int, default=48, help="of a test image, whose noise counts as an error")
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    options = parser.parse_args(sys.argv[sys.argv.index("--") + 1 :])
    make_scene()
    settings(options.size, options.threads)
    data = bpy.data.cameras.new("camera")
    data.angle, data.clip_start, data.clip_end = FOV_RAD, 0.1, 100
    camera = bpy.data.objects.new("camera", data)
    scene = bpy.context.scene
    scene.collection.objects.link(camera)
    scene.camera = camera
    for split, count, phase in (("train", options.train, 0.0), ("test", options.test, 1.0)):
        frames = []
        for k, pose in enumerate(camera_poses(count, phase)):
            frames.append({"file_path": f"./{split}/r_{k}", "transform_matrix": [list(row) for row in pose]})
        options.out.mkdir(parents=True, exist_ok=True)
        document = {"camera_angle_x": FOV_RAD, "frames": frames}
        (options.out / f"transforms_{split}.json").write_text(json.dumps(document, indent=1))
        for k, pose in enumerate(camera_poses(count, phase)):
            target = options.out / split / f"r_{k}.png"
            if target.exists():
                continue
            camera.matrix_world = pose
            scene.cycles.samples = options.samples if split == "train" else options.test_samples
            scene.cycles.seed = k + (0 if split == "train" else 10000)
            scene.render.filepath = str(target.with_suffix(".part.png").absolute())
            begin = time.time()
            bpy.ops.render.render(write_still=True)
            os.replace(scene.render.filepath, target)
            print(f"{target} {time.time() - begin:.1f} s", flush=True)


main()
