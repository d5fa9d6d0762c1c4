# SPDX-License-Identifier: Apache-2.0
"""Casts rays against the scene's polygons, inside Blender: LiDAR scans, and depth of the novel views."""
import cv2
import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

import cameras
import develop
import jobs as job_list
import las
import lidar
import materials
import trajectory
from lidar import POSITION_M, RANGE_M, REVOLUTION_S, STEPS
from settings import FIRST_ID, FIRST_TIME_S, SCANNED_VIEWS, frame_time_s
from traffic import TRAFFIC

DEPTH_LIMIT_MM = 65535  # the largest 16-bit number


def coarse(depth_mm):
    """Rounds to nine significant bits (0.2 %) and at least 16 mm, which halves the files."""
    step = 2.0 ** np.maximum(4, np.floor(np.log2(np.maximum(depth_mm, 1))) - 8)
    return np.minimum(step * np.round(depth_mm / step), DEPTH_LIMIT_MM)


class Caster:
    """Returns polygons of some objects in the frame of `origin` (the world by default)."""

    def __init__(self, items, origin=None):
        graph = bpy.context.evaluated_depsgraph_get()
        vertices, faces, self.surfaces = [], [], []
        for item in items:
            evaluated = item.evaluated_get(graph)
            mesh = evaluated.to_mesh()
            if mesh is None or not mesh.vertices:
                continue
            m = np.array(item.matrix_world)
            if origin is not None:
                m = np.linalg.inv(origin) @ m
            points = np.empty(3 * len(mesh.vertices), np.float32)
            mesh.vertices.foreach_get("co", points)
            first = len(vertices)
            vertices += (points.reshape(-1, 3) @ m[:3, :3].T + m[:3, 3]).tolist()
            surfaces = [materials.lidar_reflectance(m.name if m else "", item.color) for m in mesh.materials or [None]]
            for polygon in mesh.polygons:
                faces.append([v + first for v in polygon.vertices])
                self.surfaces.append(surfaces[polygon.material_index])
            evaluated.to_mesh_clear()
        self.tree = BVHTree.FromPolygons(vertices, faces)

    def cast(self, origin, directions, limit):
        """Returns distance [n] (inf: no hit) and reflected light [n] along unit directions [n, 3] from one origin."""
        hit, at, cast = Vector(origin), [], self.tree.ray_cast
        for d in directions.tolist():
            _, normal, face, distance = cast(hit, Vector(d), limit)
            if face is None:
                at.append((np.inf, 0.0))
            else:
                at.append((distance, lidar.reflected(*self.surfaces[face], abs(normal.dot(Vector(d))))))
        distance, light = np.array(at).T
        return distance, light


def _static():
    moving = lambda name: name.startswith("traffic_") or name == "ego bonnet"
    return [o for o in bpy.data.objects if o.type in ("MESH", "FONT") and not moving(o.name)]


def _packets(settings, variant, static, moving):
    """Returns all packets of a drive: {packet number: (time_s, points in the body at that time, intensity)}."""
    frames = settings.frames_of(variant)
    step = REVOLUTION_S / STEPS
    packets = {}
    for number in range(-STEPS // 2, round(frame_time_s(frames - 1) / step) + STEPS // 2 + 1):
        t = number * step
        rays = lidar.rays(number)
        pose = trajectory.world_from_body(t)
        origin = pose[:3, :3] @ POSITION_M + pose[:3, 3]
        world_rays = rays @ pose[:3, :3].T
        distance, light = static.cast(origin, world_rays, RANGE_M)
        for vehicle, caster in moving:
            world_from_car = vehicle.world_from_car(t)
            turn = world_from_car[:3, :3]
            near, own = caster.cast(turn.T @ (origin - world_from_car[:3, 3]), world_rays @ turn, RANGE_M)
            distance, light = np.minimum(distance, near), np.where(near < distance, own, light)
        seen, measured, intensity = lidar.measure(distance, light, settings.np_rng("lidar", variant, number))
        packets[number] = (t, rays[seen] * measured[seen, None] + POSITION_M, intensity[seen])
    return packets


def _novel_scans(settings, static):
    """Writes scans from poses of novel views, the sensor standing still: their points have no times of their own.

    Azimuths are half a step off the recorded ones, so that no ray fires straight behind, where a turn ends."""
    rays = np.concatenate([lidar.rays(n + 0.5) for n in range(STEPS)])
    channel = np.tile(np.arange(len(lidar.ELEVATIONS_DEG))[::-1], STEPS)
    for name in SCANNED_VIEWS:
        if name not in settings.novel:
            continue
        folder = settings.folder("street") / "novel" / name / "lidar"
        folder.mkdir(parents=True, exist_ok=True)
        share = []
        for index in job_list.novel_indices(settings):
            job = job_list.Job("street", "", index, name)
            pose = job.world_from_body(job.exposure_s)
            distance, light = static.cast(pose[:3, :3] @ POSITION_M + pose[:3, 3], rays @ pose[:3, :3].T, RANGE_M)
            seen, measured, intensity = lidar.measure(distance, light, settings.np_rng("lidar", name, index))
            points = rays[seen] * measured[seen, None] + POSITION_M
            las.write(folder / f"frame_{job.frame_id:07d}.las", points, intensity[seen], channel=channel[seen])
            share.append(seen.mean())
        print(f"lidar: {name}, {len(share)} scans, {100 * np.mean(share):.1f} % of the rays return")


def _revolutions(settings, variant, packets):
    """Writes file i with the revolution around frame i's time; frames are 2/3 of a revolution apart."""
    folder = settings.folder(variant) / "dynamic" / "raw-revolutions"
    folder.mkdir(parents=True, exist_ok=True)
    counts = []
    for i in range(settings.frames_of(variant)):
        middle = round(frame_time_s(i) * STEPS / REVOLUTION_S)
        own = [packets[n] for n in range(middle - STEPS // 2, middle + STEPS // 2)]
        time_ns = np.concatenate([np.full(len(p), round((FIRST_TIME_S + t) * 1e9), float) for t, p, _ in own])
        las.write(
            folder / f"frame_{FIRST_ID + i:07d}.las",
            np.concatenate([p for _, p, _ in own]),
            np.concatenate([v for _, _, v in own]),
            gps_time=time_ns,
        )
        counts.append(len(time_ns))
    print(f"lidar: {variant}, {min(counts)} to {max(counts)} points a revolution")


def _depths(settings, static):
    """Returns millimetres along the ray through each pixel's centre, rounded; 0: sky, 65535: 65.535 m and more."""
    rig = cameras.rig(settings.size)
    for job in job_list.all_jobs(settings):
        target = job.depth(settings)
        if not job.novel or target.exists():
            continue
        camera = rig[job.camera]
        width, height = camera.size_px
        v, u = np.mgrid[0:height, 0:width].astype(float)
        rays, inside = cameras.unproject(camera, u, v)
        pose = job.world_from_body(job.exposure_s) @ camera.body_from_camera()
        distance, _ = static.cast(pose[:3, 3], rays.reshape(-1, 3) @ pose[:3, :3].T, 2000.0)
        seen = np.isfinite(distance) & inside.ravel()
        depth_mm = coarse(np.where(seen, 1000 * distance, 0)).astype(np.uint16)
        develop.write_image(target, depth_mm.reshape(height, width), cv2.IMWRITE_PNG_COMPRESSION, 9)
    print("depth of the new views: done")


def raycast(settings):
    bpy.ops.wm.open_mainfile(filepath=f"{settings.work}/street.blend")
    static = Caster(_static())
    for variant in settings.variants:
        if variant in ("rolling", "traffic_edited"):
            continue  # cameras only
        moving = []
        if variant == "traffic":
            moving = [(v, Caster([bpy.data.objects[f"traffic_{v.object_id}"]], v.world_from_car(0.0))) for v in TRAFFIC]
        _revolutions(settings, variant, _packets(settings, variant, static, moving))
    if "street" in settings.variants:
        _novel_scans(settings, static)
    _depths(settings, static)
