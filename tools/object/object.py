# SPDX-License-Identifier: Apache-2.0
"""A toy excavator of plastic bricks, seen from all around: an object scene in the Blender format, for benchmarks.

    blender --background --python-exit-code 1 --python tools/object/object.py -- build/object

Everything is computed from a seed. Existing images are kept, so an interrupted run continues.
"""
import argparse
import json
import math
import os
import sys
import time
from pathlib import Path

import bpy
from mathutils import Vector

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not
from excavator import arm, cabin, deck, gears, ground, move, track, turn
from materials import material
from parts import Parts

FOV_RAD = 0.6911112070083618  # field of view and distance of the well-known sets of this format
DISTANCE = 4.031128874149275


def text(words, size, name, world_from_text):
    """Raised letters, legible from +z of their frame."""
    curve = bpy.data.curves.new("text", "FONT")
    curve.body, curve.size, curve.align_x, curve.align_y = words, size, "CENTER", "CENTER"
    curve.extrude, curve.bevel_depth, curve.resolution_u = 0.05 * size, 0.01 * size, 4
    curve.materials.append(material(name))
    item = bpy.data.objects.new("text", curve)
    item.matrix_world = world_from_text
    bpy.context.scene.collection.objects.link(item)


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
