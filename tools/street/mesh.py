# SPDX-License-Identifier: Apache-2.0
"""Polygons with materials and texture coordinates in metres, and their conversion to Blender meshes."""
import math

import bpy
import numpy as np
from mathutils import Matrix

UNIT_UV = [(0, 0), (1, 0), (1, 1), (0, 1)]


class Mesh:
    def __init__(self):
        self.vertices, self.faces, self.materials, self.uvs, self.smooth = [], [], [], [], []

    def polygon(self, points, material, uvs=None, smooth=False):
        first = len(self.vertices)
        self.vertices += [tuple(map(float, p)) for p in points]
        self.faces.append(tuple(range(first, first + len(points))))
        self.materials.append(material)
        self.uvs += [tuple(map(float, uv)) for uv in uvs] if uvs is not None else [(0.0, 0.0)] * len(points)
        self.smooth.append(smooth)

    def quad(self, a, b, c, d, material, uvs=None):
        """Adds a quad. Texture coordinates default to the two coordinates along which it extends."""
        if uvs is None:
            normal = abs(np.cross(np.subtract(b, a), np.subtract(d, a)))
            axis = int(np.argmax(normal))
            i, j = [(1, 2), (0, 2), (0, 1)][axis]
            uvs = [(p[i] + 3.1 * axis, p[j]) for p in (a, b, c, d)]
        self.polygon([a, b, c, d], material, uvs)

    def box(self, x0, x1, y0, y1, z0, z1, material, back=True):
        """Adds an axis-parallel box; without the face at y0 if back is false."""
        q = self.quad
        q((x0, y1, z0), (x1, y1, z0), (x1, y1, z1), (x0, y1, z1), material)
        if back:
            q((x1, y0, z0), (x0, y0, z0), (x0, y0, z1), (x1, y0, z1), material)
        q((x0, y0, z0), (x0, y1, z0), (x0, y1, z1), (x0, y0, z1), material)
        q((x1, y1, z0), (x1, y0, z0), (x1, y0, z1), (x1, y1, z1), material)
        q((x0, y0, z1), (x0, y1, z1), (x1, y1, z1), (x1, y0, z1), material)
        q((x0, y1, z0), (x0, y0, z0), (x1, y0, z0), (x1, y1, z0), material)

    def cylinder(self, p0, p1, r0, r1, material, sides=12, caps=True, smooth=True):
        """Adds a truncated cone from p0 (radius r0) to p1 (r1)."""
        p0, p1 = np.array(p0, float), np.array(p1, float)
        length = np.linalg.norm(p1 - p0)
        axis = (p1 - p0) / length
        a = np.cross(axis, (0, 0, 1) if abs(axis[2]) < 0.9 else (1, 0, 0))
        a /= np.linalg.norm(a)
        b = np.cross(axis, a)
        angles = [2 * math.pi * k / sides for k in range(sides)]
        ring = lambda p, r: [p + r * (math.cos(w) * a + math.sin(w) * b) for w in angles]
        low, high = ring(p0, r0), ring(p1, r1)
        for k in range(sides):
            n = (k + 1) % sides
            u0, u1 = angles[k] * r0, (angles[k] + 2 * math.pi / sides) * r0
            self.polygon(
                [low[k], low[n], high[n], high[k]], material, [(u0, 0), (u1, 0), (u1, length), (u0, length)], smooth
            )
        if caps:
            self.polygon(high, material, [(p[0], p[1]) for p in high])
            self.polygon(low[::-1], material, [(p[0], p[1]) for p in low[::-1]])

    def tube(self, points, radius, material, sides=8):
        for p, q in zip(points[:-1], points[1:]):
            self.cylinder(p, q, radius, radius, material, sides, caps=False)

    def leaf(self, center, half_length, half_width, rng, material):
        """Adds a rhombus of random orientation."""
        d1 = np.array([rng.gauss(0, 1) for _ in range(3)])
        d1 /= np.linalg.norm(d1)
        d2 = np.cross(d1, [rng.gauss(0, 1) for _ in range(3)])
        d2 /= np.linalg.norm(d2) + 1e-9
        self.polygon(
            [center - half_length * d1, center + half_width * d2, center + half_length * d1, center - half_width * d2],
            material,
        )

    def data(self, name, materials, weld=False):
        """Returns a Blender mesh; weld joins coincident vertices, for smooth shading across faces."""
        mesh = bpy.data.meshes.new(name)
        vertices, faces = self.vertices, self.faces
        if weld:
            index, unique = {}, []
            for v in vertices:
                key = tuple(round(c, 5) for c in v)
                if key not in index:
                    index[key] = len(unique)
                    unique.append(v)
            faces = [tuple(index[tuple(round(c, 5) for c in vertices[i])] for i in f) for f in faces]
            vertices = unique
        mesh.from_pydata(vertices, [], faces)
        used = list(dict.fromkeys(self.materials))
        for m in used:
            mesh.materials.append(materials[m])
        slot = {m: i for i, m in enumerate(used)}
        mesh.polygons.foreach_set("material_index", [slot[m] for m in self.materials])
        mesh.polygons.foreach_set("use_smooth", self.smooth)
        mesh.uv_layers.new(name="UV").data.foreach_set("uv", np.array(self.uvs, np.float32).ravel())
        mesh.update()
        return mesh


def to_matrix(m):
    return Matrix([list(map(float, row)) for row in m])


class Stage:
    """The Blender scene under construction, with its materials."""

    def __init__(self, materials):
        self.materials = materials

    def place(self, name, data, world_from_local=None, color=None):
        item = bpy.data.objects.new(name, data)
        bpy.context.scene.collection.objects.link(item)
        if world_from_local is not None:
            item.matrix_world = to_matrix(world_from_local)
        if color is not None:
            item.color = (*color, 1)
        return item

    def add(self, name, mesh, world_from_local=None, color=None):
        return self.place(name, mesh.data(name, self.materials), world_from_local, color)

    def text(self, words, size_m, material, world_from_local, x, y, z):
        """Adds letters in the plane y = const of a local frame, legible when viewed along -y."""
        face = np.eye(4)
        face[:3, :3] = np.array([(-1, 0, 0), (0, 0, 1), (0, 1, 0)]).T
        face[:3, 3] = (x, y, z)
        curve = bpy.data.curves.new("text", "FONT")
        curve.body, curve.size, curve.align_x, curve.align_y, curve.resolution_u = words, size_m, "CENTER", "CENTER", 3
        curve.materials.append(self.materials[material])
        return self.place("text", curve, world_from_local @ face)
