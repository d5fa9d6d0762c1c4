# SPDX-License-Identifier: Apache-2.0
"""The recording's files in the aiMotive layout: images, calibration, egomotion, boxes, poses of the novel views."""
import json
from dataclasses import replace

import numpy as np

import cameras
import develop
import jobs as job_list
import lidar
import trajectory
from settings import FIRST_ID, FIRST_TIME_S, NOVEL_VIEWS, ROLLING_READOUT_S, frame_time_s
from traffic import EDITS, TRAFFIC, TYPE_NAMES

LICENSE = """Made by tools/street of this repository; nothing in it comes from elsewhere.

CC0 1.0 Universal (public domain dedication): to the extent possible under law, the authors have waived all copyright
and related or neighbouring rights to this recording.
https://creativecommons.org/publicdomain/zero/1.0/legalcode
"""


def _dump(value, path):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(value, indent=1) + "\n")


def _extrinsic(body_from_sensor, position_m, angles_deg):
    return {
        "RT_body_from_sensor": body_from_sensor.tolist(),
        "RT_sensor_from_body": np.linalg.inv(body_from_sensor).tolist(),
        "custom_vars": {},
        "device_id": "synthetic",
        "extrinsic_error": -1,
        "pos_meter": list(position_m),
        "yaw_pitch_roll_deg": list(angles_deg),
    }


def _camera_entry(camera, yaw_error_deg):
    yaw, pitch, roll = camera.yaw_pitch_roll_deg
    camera = replace(camera, yaw_pitch_roll_deg=(yaw + yaw_error_deg, pitch, roll))
    distortion = [0 if c == 0 else c for c in camera.distortion]  # integer zeros, as in the dataset
    entry = {
        **_extrinsic(camera.body_from_camera(), camera.position_m, camera.yaw_pitch_roll_deg),
        "distortion_coeffs": distortion,
        "focal_length_px": list(camera.focal_px),
        "image_resolution_px": list(camera.size_px),
        "label": camera.name,
        "model": camera.model,
        "principal_point_px": list(camera.center_px),
        "reprojection_error": -1,
        "sensor_type": "camera",
        "transform": "none",
        "uri": f"synthetic:{camera.name}",
    }
    return {**entry, "xi": camera.xi} if camera.model == "mei" else entry


def calibration(settings, variant, exact):
    """Returns calibration.json; if exact, calibration_true.json, which also has time offsets and readout times."""
    rig = cameras.rig(settings.size)
    sensors = {
        "Imu0": {
            "label": "Imu0",
            "pos_meter": [0, 0, 0],
            "sensor_type": "imu_ins",
            "uri": "synthetic:Imu0",
            "yaw_pitch_roll_deg": [0, 0, 0],
        }
    }
    for name in job_list.cameras_of(variant):
        sensors[name] = _camera_entry(rig[name], 0.0 if exact else trajectory.YAW_ERROR_DEG.get(name, 0.0))
        if exact:
            sensors[name]["time_offset_s"] = trajectory.TIME_OFFSET_S.get(name, 0.0)
            sensors[name]["readout_s"] = ROLLING_READOUT_S if variant == "rolling" else 0.0
    if variant != "rolling":
        body_from_lidar = np.eye(4)
        body_from_lidar[:3, 3] = lidar.POSITION_M
        sensors["M_LIDAR_M"] = {
            **_extrinsic(body_from_lidar, lidar.POSITION_M, (0, 0, 0)),
            "label": "M_LIDAR_M",
            "sensor_type": "lidar",
            "laser_count": len(lidar.ELEVATIONS_DEG),
            "uri": "synthetic:M_LIDAR_M",
        }
    return dict(sorted(sensors.items()))


def _egomotion(settings, frames, exact):
    """Returns poses at the frames' times, keyed by id."""
    ecef_from_world = trajectory.ecef_from_world()
    noise = trajectory.pose_noise(settings, frames)
    entries = {}
    for i in range(frames):
        pose = trajectory.world_from_body(frame_time_s(i))
        pose = ecef_from_world @ (pose if exact else trajectory.with_noise(pose, noise[i]))
        time_s = FIRST_TIME_S + frame_time_s(i)
        entries[str(FIRST_ID + i)] = {"RT_ECEF_body": pose.tolist(), "time": time_s, "time_host": time_s}
    return entries


def _quaternion(r):
    """w, x, y, z of a rotation about an axis close to z."""
    w = np.sqrt(max(0.0, 1 + np.trace(r))) / 2
    if w > 1e-3:
        return [w, (r[2, 1] - r[1, 2]) / (4 * w), (r[0, 2] - r[2, 0]) / (4 * w), (r[1, 0] - r[0, 1]) / (4 * w)]
    z = np.sqrt(max(0.0, 1 - r[0, 0] - r[1, 1] + r[2, 2])) / 2
    return [(r[1, 0] - r[0, 1]) / (4 * z), (r[0, 2] + r[2, 0]) / (4 * z), (r[1, 2] + r[2, 1]) / (4 * z), z]


def _boxes(settings, index):
    """dynamic/box/3d_body/frame_<id>.json: boxes in the body at the frame's time."""
    t, step = frame_time_s(index), 1e-3
    velocity = lambda pose_at: (pose_at(t + step)[:3, 3] - pose_at(t - step)[:3, 3]) / (2 * step)
    body = trajectory.world_from_body(t)
    objects = []
    for vehicle in TRAFFIC:
        low, high = (np.array(c) for c in vehicle.bounds)
        body_from_car = np.linalg.inv(body) @ vehicle.world_from_car(t)
        center = body_from_car[:3, :3] @ ((low + high) / 2) + body_from_car[:3, 3]
        relative = body[:3, :3].T @ (velocity(vehicle.world_from_car) - velocity(trajectory.world_from_body))
        entry = {"ActorName": f"{TYPE_NAMES[vehicle.kind]} {vehicle.object_id:02d}"}
        entry |= {f"BoundingBox3D Extent {a}": float(v) for a, v in zip("XYZ", high - low)}
        entry |= {
            f"BoundingBox3D Orientation Quat {a}": float(v) for a, v in zip("WXYZ", _quaternion(body_from_car[:3, :3]))
        }
        entry |= {f"BoundingBox3D Origin {a}": float(v) for a, v in zip("XYZ", center)}
        entry |= {"ObjectId": vehicle.object_id, "ObjectType": TYPE_NAMES[vehicle.kind], "Occluded": 0}
        entry |= {f"Relative Velocity {a}": float(v) for a, v in zip("XYZ", relative)}
        objects.append({**entry, "Truncated": 0})
    return {"CapturedObjects": objects, "Timestamp": str(round((FIRST_TIME_S + t) * 1e9))}


def _novel_poses(settings, name):
    ecef_from_world = trajectory.ecef_from_world()
    images = []
    for i in job_list.novel_indices(settings):
        job = job_list.Job("street", cameras.NOVEL_CAMERA, i, name)
        view = {
            "file": f"{job.name}.jpg",
            "camera": job.camera,
            "frame_id": job.frame_id,
            "RT_ECEF_body": (ecef_from_world @ job.world_from_body(job.exposure_s)).tolist(),
        }
        shift, yaw = NOVEL_VIEWS[name]
        if yaw == 0:
            view["shift_body_m"] = list(shift)
        images.append(view)
    camera = cameras.rig(settings.size)[cameras.NOVEL_CAMERA]
    return {"calibration": {camera.name: _camera_entry(camera, 0.0)}, "images": images}


def _images(settings):
    rig, missing = cameras.rig(settings.size), []
    for job in job_list.all_jobs(settings):
        exr, jpeg = job.render(settings), job.image(settings)
        if not exr.exists():
            missing.append(job.key)
        elif job.variant not in settings.variants:
            continue  # rendered to be compared with
        elif not jpeg.exists() or jpeg.stat().st_mtime < exr.stat().st_mtime:
            develop.develop(rig[job.camera], exr, jpeg)
            unedited = job.unedited.render(settings)
            if job.edit and unedited.exists():
                mask = develop.changed(rig[job.camera], exr, unedited)
                develop.write_image(job.changed(settings), mask, develop.cv2.IMWRITE_PNG_COMPRESSION, 9)
    if missing:
        print(f"write: {len(missing)} images are not rendered yet, the first is {missing[0]}")


def write(settings):
    for variant in settings.variants:
        folder, frames = settings.folder(variant), settings.frames_of(variant)
        if variant == "traffic_edited":
            for name, edit in EDITS.items():
                _dump(edit.to_json(), folder / name / "edit.json")
            continue  # the rest is the traffic's
        for suffix, exact in (("", False), ("_true", True)):
            _dump(calibration(settings, variant, exact), folder / "sensor/calibration" / f"calibration{suffix}.json")
            _dump(_egomotion(settings, frames, exact), folder / "sensor/gnssins" / f"egomotion2{suffix}.json")
        if variant == "traffic":
            for i in range(frames):
                _dump(_boxes(settings, i), folder / "dynamic/box/3d_body" / f"frame_{FIRST_ID + i:07d}.json")
        if variant == "street":
            for name in settings.novel:
                _dump(_novel_poses(settings, name), folder / "novel" / name / "poses.json")
        (folder / "LICENSE").write_text(LICENSE)
    _images(settings)
