# SPDX-License-Identifier: Apache-2.0
"""Boxes, cylinders, gears and bricks that meshes are made of."""
import math

import bpy
from mathutils import Matrix, Vector

from materials import PLASTIC, material

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
