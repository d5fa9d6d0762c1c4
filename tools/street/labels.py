# SPDX-License-Identifier: Apache-2.0
"""Casts the pixels' rays of the traffic variant, inside Blender: which vehicle each shows, depth and optical flow.

Writes WORK/labels/CAMERA/<frame id>_ids.png (16 bit: the object's id, 0 the static world), _whole_<object id>.png
(white: where the object would be seen if nothing were before it), _depth.png (millimetres along the ray) and .flo
(pixels until the camera's next image, 1e10 where not known), of every third frame."""
from pathlib import Path

import bpy
import cv2
import numpy as np

import cameras
import jobs as job_list
import trajectory
from raycast import Caster, _static
from settings import frame_time_s
from traffic import TRAFFIC

FAR_M = 2000.0
EVERY = 3


def _flow(camera, points, owner, job, later_s):
    """Motion [n, 2] in pixels of world points [n, 3] until `later_s`; owner [n]: index into TRAFFIC, -1 static."""
    for k, vehicle in enumerate(TRAFFIC):
        motion = vehicle.world_from_car(later_s) @ np.linalg.inv(vehicle.world_from_car(job.exposure_s))
        own = owner == k
        points[own] = points[own] @ motion[:3, :3].T + motion[:3, 3]
    camera_from_world = np.linalg.inv(trajectory.world_from_body(later_s) @ camera.body_from_camera())
    in_camera = points @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]
    return np.where(in_camera[:, 2:] > 0, cameras.project(camera, in_camera), np.nan)


def labels(settings):
    bpy.ops.wm.open_mainfile(filepath=f"{settings.work}/street.blend")
    static = Caster(_static())
    moving = [Caster([bpy.data.objects[f"traffic_{v.object_id}"]], v.world_from_car(0.0)) for v in TRAFFIC]
    rig = cameras.rig(settings.size)
    frames = settings.frames_of("traffic")
    for name in job_list.cameras_of("traffic"):
        folder = Path(settings.work) / "labels" / name
        folder.mkdir(parents=True, exist_ok=True)
        camera = rig[name]
        width, height = camera.size_px
        v, u = np.mgrid[0:height, 0:width].astype(float)
        rays, inside = cameras.unproject(camera, u, v)
        rays, inside = rays.reshape(-1, 3), inside.ravel()
        for index in range(0, frames, EVERY):
            job = job_list.Job("traffic", name, index)
            pose = job.world_from_body(job.exposure_s) @ camera.body_from_camera()
            origin, world_rays = pose[:3, 3], rays @ pose[:3, :3].T
            distance, _ = static.cast(origin, world_rays, FAR_M)
            owner = np.full(len(rays), -1)
            for k, (vehicle, caster) in enumerate(zip(TRAFFIC, moving)):
                car = vehicle.world_from_car(job.exposure_s)
                turn = car[:3, :3]
                near, _ = caster.cast(turn.T @ (origin - car[:3, 3]), world_rays @ turn, FAR_M)
                whole = np.where(np.isfinite(near) & inside, 255, 0).astype(np.uint8).reshape(height, width)
                cv2.imwrite(str(folder / f"{job.frame_id}_whole_{vehicle.object_id}.png"), whole)
                owner = np.where(near < distance, k, owner)
                distance = np.minimum(distance, near)
            ids = np.array([0, *(vehicle.object_id for vehicle in TRAFFIC)])[np.where(inside, owner, -1) + 1]
            image = lambda values: values.reshape(height, width).astype(np.uint16)
            cv2.imwrite(str(folder / f"{job.frame_id}_ids.png"), image(ids))
            seen = inside & np.isfinite(distance)
            depth_mm = np.minimum(65535, np.where(seen, 1000 * distance, 0))
            cv2.imwrite(str(folder / f"{job.frame_id}_depth.png"), image(depth_mm))
            flow = np.full((len(rays), 2), np.nan)
            if index + 1 < frames:
                points = origin + world_rays[seen] * distance[seen, None]
                to = _flow(camera, points, owner[seen], job, job_list.Job("traffic", name, index + 1).exposure_s)
                flow[seen] = to - np.stack([u.ravel(), v.ravel()], 1)[seen]
            flow = np.where(np.isfinite(flow), flow, 1e10).astype(np.float32)
            with open(folder / f"{job.frame_id}.flo", "wb") as file:
                file.write(b"PIEH" + np.array([width, height], np.int32).tobytes() + flow.tobytes())
            print(f"labels: {job.name}")
