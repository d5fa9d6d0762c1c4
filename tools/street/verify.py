# SPDX-License-Identifier: Apache-2.0
"""Compares images with the files. A marker scene gives projection errors and row times, two renders with different
seeds give the noise floor. render_* run inside Blender, report outside."""
import json
import math
from pathlib import Path

import numpy as np

import cameras
import develop
import jobs as job_list
import trajectory
from settings import ROLLING_READOUT_S

MARKER_FRAMES = (0, 31)
ROLLING_FRAME = 12
SPIN_DEG_S = 150.0  # turn rate of the body, added for the rolling marker images: 0.2 ms are 0.3 px then
NOISE_FRAME = 20


def spinning(t):
    """Body pose whose motion a rolling shutter shows clearly, turning to the right."""
    center = ROLLING_FRAME / 15
    return trajectory.shifted(trajectory.world_from_body(t), (0, 0, 0), -SPIN_DEG_S * (t - center))


def _cases():
    """(name, camera name, time, pose at a time, readout)"""
    for name in cameras.rig(1):
        for i in MARKER_FRAMES:
            yield f"{name}_{i}", name, i / 15, trajectory.world_from_body, 0.0
    for name in cameras.FRONT_CAMERAS:
        yield f"{name}_rolling", name, ROLLING_FRAME / 15, spinning, ROLLING_READOUT_S


def _markers(settings, case, camera, t, pose_at):
    """Returns world points [n, 3] in view, 3 to 25 m away, on a jittered grid of pixels, and their distances."""
    rng = settings.np_rng("markers", case)
    width, height = camera.size_px
    v, u = np.mgrid[14 : height - 15 : 9j, 14 : width - 15 : 13j]
    u, v = u + rng.uniform(-5, 5, u.shape), v + rng.uniform(-5, 5, v.shape)
    rays, inside = cameras.unproject(camera, u, v)
    if camera.model == "mei":  # where a marker is still round
        inside &= np.degrees(np.arccos(rays[..., 2])) < 92
    distance = rng.uniform(3, 25, u.shape)[inside]
    world_from_camera = pose_at(t) @ camera.body_from_camera()
    return (rays[inside] * distance[:, None]) @ world_from_camera[:3, :3].T + world_from_camera[:3, 3], distance


def _seen_at(camera, points, t, pose_at, readout_s):
    """Returns pixels [n, 2] of world points under a rolling shutter, and their speed in px/s. Iterates row times."""

    def at(times):
        out = np.empty((len(points), 2))
        for k, (p, time) in enumerate(zip(points, times)):
            m = np.linalg.inv(pose_at(time) @ camera.body_from_camera())
            out[k] = cameras.project(camera, (m[:3, :3] @ p + m[:3, 3])[None])[0]
        return out

    times = np.full(len(points), t)
    for _ in range(8 if readout_s else 1):
        pixels = at(times)
        times = t + ((pixels[:, 1] + 0.5) / camera.size_px[1] - 0.5) * readout_s
    return pixels, (at(times + 1e-4) - at(times - 1e-4)) / 2e-4


def render_markers(settings):
    import bpy
    from mesh import Mesh
    from render import Lens, cycles_settings, expose

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    cycles_settings(32)
    scene.render.use_persistent_data = scene.cycles.use_fast_gi = False
    glow = bpy.data.materials.new("glow")
    glow.use_nodes = True
    glow.node_tree.nodes.clear()
    output, emission = (glow.node_tree.nodes.new(f"ShaderNode{k}") for k in ("OutputMaterial", "Emission"))
    glow.node_tree.links.new(emission.outputs[0], output.inputs[0])
    ball = Mesh()
    for low, high in zip(np.linspace(-90, 80, 18), np.linspace(-80, 90, 18)):  # bands of latitude
        (z0, r0), (z1, r1) = ((math.sin(a), math.cos(a)) for a in np.radians([low, high]))
        ball.cylinder((0, 0, z0), (0, 0, z1), r0, r1, "glow", 24, caps=False)
    ball = ball.data("ball", {"glow": glow})
    lens, rig = Lens(), cameras.rig(settings.size)
    folder = Path(settings.work) / "markers"
    folder.mkdir(parents=True, exist_ok=True)
    for case, name, t, pose_at, readout_s in _cases():
        camera = rig[name]
        plan = cameras.render_plan(camera)
        for item in [o for o in bpy.data.objects if o.name.startswith("marker")]:
            bpy.data.objects.remove(item)
        radius = 0.0075 if camera.model == "mei" else 1.8 / camera.focal_px[0]
        for point, distance in zip(*_markers(settings, case, camera, t, pose_at)):
            item = bpy.data.objects.new("marker", ball)
            scene.collection.objects.link(item)
            item.location, item.scale = tuple(point), (distance * radius,) * 3
        lens.set_camera(camera, plan)
        if readout_s:
            lens.roll(camera, plan, pose_at, t, readout_s)
        else:
            lens.still(pose_at(t))
        expose(folder / f"{case}.exr", case)


def render_noise(settings):
    from render import Lens, open_scene, render_job

    open_scene(settings)
    lens, rig = Lens(), cameras.rig(settings.size)
    folder = Path(settings.work) / "noise"
    folder.mkdir(parents=True, exist_ok=True)
    for name in rig:
        job = job_list.Job("street", name, NOISE_FRAME)
        for seed in "ab":
            if not (folder / f"{name}_{seed}.exr").exists():
                render_job(job, settings, lens, rig, folder / f"{name}_{seed}.exr", seed)


def _spots(image):
    """Returns centroids [n, 2] of the bright spots, weighted by radiance."""
    import cv2

    count, labels = cv2.connectedComponents((image > 0.02 * image.max()).astype(np.uint8))
    labels, weight = labels.ravel(), image.ravel()
    v, u = np.indices(image.shape).reshape(2, -1)
    total = np.bincount(labels, weight, count)
    return np.stack([np.bincount(labels, weight * c, count) / total for c in (u, v)], 1)[1:]


def _projection(settings):
    rig, figures, groups = cameras.rig(settings.size), {}, {}
    for case, name, t, pose_at, readout_s in _cases():
        groups.setdefault(f"{name} {'rolling' if readout_s else 'still'}", []).append(
            (case, name, t, pose_at, readout_s)
        )
    for group, cases in groups.items():
        errors, row_times, missing = [], [], 0
        for case, name, t, pose_at, readout_s in cases:
            camera = rig[name]
            image = develop.resample(camera, develop.read_exr(Path(settings.work) / "markers" / f"{case}.exr")).mean(
                -1
            )
            found = _spots(image)
            points, _ = _markers(settings, case, camera, t, pose_at)
            pixels, speed = _seen_at(camera, points, t, pose_at, readout_s)
            for pixel, flow in zip(pixels, speed):
                apart = np.sort(np.hypot(*(pixels - pixel).T))[1]
                if apart < 10 or not all(6 < c < n - 7 for c, n in zip(pixel, camera.size_px)):
                    continue
                error = found[np.hypot(*(found - pixel).T).argmin()] - pixel
                if np.hypot(*error) > 5:
                    missing += 1
                    continue
                errors.append(error)
                row_times.append(error @ flow / (flow @ flow))
        errors = np.array(errors)
        length = np.hypot(*errors.T)
        figures[group] = {
            "markers": len(errors),
            "missing": missing,
            "mean_px": errors.mean(0).round(4).tolist(),
            "rms_px": round(float(np.sqrt((length**2).mean())), 4),
            "max_px": round(float(length.max()), 4),
        }
        if cases[0][4]:
            figures[group]["row_time_ms"] = {
                "rms": round(1e3 * float(np.sqrt(np.mean(np.square(row_times)))), 4),
                "max": round(1e3 * float(np.abs(row_times).max()), 4),
            }
    return figures


def _noise(settings):
    figures = {}
    for name, camera in cameras.rig(settings.size).items():
        a, b = (
            develop.tone(
                develop.resample(camera, develop.read_exr(Path(settings.work) / "noise" / f"{name}_{s}.exr"))
            ).astype(float)
            for s in "ab"
        )
        width, height = camera.size_px
        _, inside = cameras.unproject(camera, *np.meshgrid(np.arange(width), np.arange(height)))
        figures[name] = round(10 * math.log10(255**2 / np.mean((a - b)[inside] ** 2)), 2)
    return figures


def report(settings):
    figures = {"projection": _projection(settings), "psnr_between_seeds_db": _noise(settings)}
    text = json.dumps(figures, indent=1)
    (Path(settings.work) / "verify.json").write_text(text + "\n")
    print(text)
    worst = max(f["max_px"] for f in figures["projection"].values() if "row_time_ms" not in f)
    late = max(f["row_time_ms"]["max"] for f in figures["projection"].values() if "row_time_ms" in f)
    assert worst < 0.3 and late < 0.2, "verify: a marker is more than 0.3 px or 0.2 ms off"
