#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Compares the places that a removed car covers with the same places where they are free.

    tools/street/free_places.py RUN REDRIVE

RUN: of samples/street_traffic with the exact poses and --holdout-every 6; REDRIVE: the program. Needs numpy and PIL.
Pixels that edited/removed changed have a place by the depth of the edited rendering, up to 60 m. The place is sought in
the other held-out frames, where their own rendering has it within 3 % of its distance and the car changes nothing.
Prints PSNR of the edited rendering against edited/removed, and of the other frames against the recorded images, over
the places that some other frame shows: of all of them, and of those within 0.4 m of the road."""
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

SAMPLE = Path(__file__).resolve().parents[2] / "samples/street_traffic"
CAMERA, FRAMES = "F_MIDLONGRANGECAM_CL", (1000, 1006, 1012, 1018)
EDITED = SAMPLE / "edited/removed"


def image(path):
    return np.asarray(Image.open(path).convert("RGB")) / 255.0


def rendered(redrive, run, folder, frame, *edit):
    """Returns the squared error's image and metres along each ray."""
    out, depth = folder / "image.png", folder / "depth.png"
    of = ["--camera", CAMERA, "--frame", str(frame), "--out", str(out), "--depth", str(depth), "--force"]
    subprocess.run([redrive, "render", run, *of, *edit], check=True, stdout=subprocess.DEVNULL)
    truth = EDITED / f"{CAMERA}_{frame:07d}.jpg" if edit else SAMPLE / f"sensor/camera/{CAMERA}/{CAMERA}_{frame:07d}.jpg"
    return ((image(out) - image(truth)) ** 2).mean(-1), np.asarray(Image.open(depth)) / 1000.0


def distorted(f, x, y):
    r2 = x * x + y * y
    k = 1 + f["k1"] * r2 + f["k2"] * r2 * r2
    p1, p2 = f["p1"], f["p2"]
    return x * k + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * k + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y


def project(f, points):
    """Returns pixels and metres from the camera."""
    pose = np.array(f["transform_matrix"])  # OpenGL axes
    x, y, z = ((points - pose[:3, 3]) @ pose[:3, :3] * (1, -1, -1)).T
    u, v = distorted(f, x / z, y / z)
    distance = np.where(z > 0, np.sqrt(x * x + y * y + z * z), np.nan)  # not behind the camera
    return f["fl_x"] * u + f["cx"], f["fl_y"] * v + f["cy"], distance


def places(f, u, v, depth):
    to_x, to_y = (u - f["cx"]) / f["fl_x"], (v - f["cy"]) / f["fl_y"]
    x, y = to_x, to_y
    for _ in range(30):
        dx, dy = distorted(f, x, y)
        x, y = x + to_x - dx, y + to_y - dy
    rays = np.stack([x, -y, -np.ones_like(x)], -1)
    pose = np.array(f["transform_matrix"])
    return pose[:3, 3] + (rays * (depth / np.linalg.norm(rays, axis=-1))[:, None]) @ pose[:3, :3].T


def main(run, redrive):
    folder = Path(tempfile.mkdtemp())
    subprocess.run([redrive, "export", run, "--to", "transforms", "--out", str(folder / "poses")], check=True)
    poses = {Path(f["file_path"]).stem: f for f in json.loads((folder / "poses/transforms.json").read_text())["frames"]}
    cameras = {frame: poses[f"{CAMERA}_{frame:07d}"] for frame in FRAMES}
    changed = {f: np.asarray(Image.open(EDITED / f"{CAMERA}_{f:07d}_changed.png").convert("L")) > 127 for f in FRAMES}
    free = {frame: rendered(redrive, run, folder, frame) for frame in FRAMES}
    road = min(f["transform_matrix"][2][3] for f in cameras.values()) - 1.25  # below the camera
    here, elsewhere, on_road = [], [], []
    for frame in FRAMES:
        error, depth = rendered(redrive, run, folder, frame, "--edit", str(EDITED / "edit.json"))
        v, u = np.nonzero(changed[frame] & (depth > 0) & (depth < 60))
        at = places(cameras[frame], u.astype(float), v.astype(float), depth[v, u])
        total, count = np.zeros(len(u)), np.zeros(len(u))
        for other in set(FRAMES) - {frame}:
            x, y, distance = project(cameras[other], at)
            x, y = (np.rint(np.nan_to_num(of, nan=-1, posinf=-1, neginf=-1)).astype(int) for of in (x, y))
            height, width = changed[other].shape
            ok = (x >= 0) & (y >= 0) & (x < width) & (y < height)
            x, y = np.where(ok, x, 0), np.where(ok, y, 0)
            ok &= (abs(free[other][1][y, x] - distance) < 0.03 * distance) & ~changed[other][y, x]
            total += np.where(ok, free[other][0][y, x], 0)
            count += ok
        shown = count > 0
        here.append(error[v, u][shown])
        elsewhere.append(total[shown] / count[shown])
        on_road.append(abs(at[shown, 2] - road) < 0.4)
    here, elsewhere, on_road = map(np.concatenate, (here, elsewhere, on_road))
    share = len(here) / sum(mask.sum() for mask in changed.values())
    for name, which in (("all", np.ones_like(on_road)), ("road", on_road)):
        removed, seen_free = (-10 * np.log10(e[which].mean()) for e in (here, elsewhere))
        print(f"{name}: {removed:.2f} dB with the car removed, {seen_free:.2f} dB free")
    print(f"{100 * share:.0f} % of the changed pixels compared")


if __name__ == "__main__":
    main(*sys.argv[1:])
