# SPDX-License-Identifier: Apache-2.0
"""Renders the job list with Cycles, inside Blender. Several processes may share a list: each locks the job that it
renders and writes it atomically."""
import fcntl
import os
import time
import zlib

import bpy
import numpy as np

import cameras
import jobs as job_list
from mesh import to_matrix
from traffic import TRAFFIC

OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
ROLLING_KEYS = 5  # camera poses of an image with a rolling shutter, interpolated linearly: 7.5 ms apart


def cycles_settings(samples, threads=1):
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    c = scene.cycles
    c.device, c.samples, c.use_adaptive_sampling, c.use_denoising = "CPU", samples, False, False
    c.max_bounces, c.diffuse_bounces, c.glossy_bounces, c.transmission_bounces = 4, 2, 2, 1
    c.transparent_max_bounces, c.volume_bounces = 2, 0
    c.caustics_reflective = c.caustics_refractive = False
    c.sample_clamp_indirect, c.blur_glossy = 3.0, 0.5
    c.pixel_filter_type, c.filter_width = "BLACKMAN_HARRIS", 1.3
    c.use_fast_gi, c.fast_gi_method, c.ao_bounces_render = True, "REPLACE", 1
    if scene.world:
        scene.world.light_settings.distance, scene.world.light_settings.ao_factor = 5.0, 1.0
    r = scene.render
    r.use_persistent_data, r.threads_mode, r.threads = True, "FIXED", threads
    r.pixel_aspect_x = r.pixel_aspect_y = 1
    r.resolution_percentage = 100
    r.image_settings.file_format, r.image_settings.color_mode = "OPEN_EXR", "RGB"
    r.image_settings.color_depth, r.image_settings.exr_codec = "16", "ZIP"
    r.film_transparent = r.use_compositing = r.use_sequencer = False
    scene.view_settings.view_transform = "Standard"


class Lens:
    """Configures the Blender camera as the lens of a rig camera."""

    def __init__(self):
        self.data = bpy.data.cameras.new("camera")
        self.item = bpy.data.objects.new("camera", self.data)
        self.item.rotation_mode = "QUATERNION"
        bpy.context.scene.collection.objects.link(self.item)
        bpy.context.scene.camera = self.item

    def set_camera(self, camera, plan):
        render = bpy.context.scene.render
        render.resolution_x, render.resolution_y = plan.size_px
        d = self.data
        d.type, d.clip_start, d.clip_end, d.sensor_fit, d.sensor_width = "PANO", 0.02, 2000, "HORIZONTAL", 36.0
        d.sensor_height = 36.0 * plan.size_px[1] / plan.size_px[0]
        d.cycles.panorama_type, d.cycles.fisheye_fov = "FISHEYE_LENS_POLYNOMIAL", 2 * np.pi
        d.cycles.fisheye_polynomial_k0 = 0.0
        px_of_mm = plan.size_px[0] / 36.0  # Blender's radius is in millimetres, its angle negative
        for k, c in enumerate(plan.polynomial):
            setattr(d.cycles, f"fisheye_polynomial_k{k + 1}", -c * px_of_mm ** (k + 1))
        self.body_from_lens = camera.body_from_camera() @ OPENGL_FROM_OPENCV

    def set_pose(self, world_from_body):
        self.item.matrix_world = to_matrix(world_from_body @ self.body_from_lens)

    def still(self, world_from_body):
        self.item.animation_data_clear()
        bpy.context.scene.render.use_motion_blur = False
        self.set_pose(world_from_body)

    def roll(self, camera, plan, world_from_body_at, exposure_s, readout_s):
        """Cycles exposes row j of n (from the top) at (j + 1) / n of the shutter. The poses there are those of the time
        at which that row's pixels are read: exposure + ((row + 0.5) / height - 0.5) readout."""
        scene = bpy.context.scene
        scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 1.0
        scene.cycles.motion_blur_position = "START"
        scene.cycles.rolling_shutter_type, scene.cycles.rolling_shutter_duration = "TOP", 0.0
        self.item.animation_data_clear()
        self.item.cycles.use_motion_blur, self.item.cycles.motion_steps = True, 3
        height, rows = camera.size_px[1], plan.size_px[1]
        last = None
        for k in range(ROLLING_KEYS):
            shutter = k / (ROLLING_KEYS - 1)
            render_row = shutter * rows - 1
            row = camera.center_px[1] + (render_row + 0.5 - rows / 2) * camera.focal_px[1] / plan.scale
            self.set_pose(world_from_body_at(exposure_s + ((row + 0.5) / height - 0.5) * readout_s))
            if last is not None and self.item.rotation_quaternion.dot(last) < 0:
                self.item.rotation_quaternion.negate()
            last = self.item.rotation_quaternion.copy()
            for path in ("location", "rotation_quaternion"):
                self.item.keyframe_insert(path, frame=1 + shutter)
        for curve in self.item.animation_data.action.fcurves:
            for point in curve.keyframe_points:
                point.interpolation = "LINEAR"
        scene.frame_set(1)


def _dress(job):
    """Shows the objects that belong into this image: traffic, the ego vehicle."""
    for vehicle in TRAFFIC:
        name = f"traffic_{vehicle.object_id}"
        for item in (bpy.data.objects[name], bpy.data.objects[name + "_plate"]):
            item.hide_render = not job.has_traffic or job.change.hides(vehicle)
        if job.has_traffic:
            bpy.data.objects[name].matrix_world = to_matrix(job.change.world_from_car(vehicle, job.exposure_s))
    bonnet = bpy.data.objects["ego bonnet"]
    bonnet.hide_render = job.camera != cameras.BONNET_CAMERA
    bonnet.matrix_world = to_matrix(job.world_from_body(job.exposure_s))


def expose(target, seed_text):
    scene = bpy.context.scene
    scene.cycles.seed = zlib.crc32(seed_text.encode()) & 0x7FFFFFFF
    scene.render.filepath = f"{target}.{os.getpid()}.exr"
    bpy.ops.render.render(write_still=True)
    os.replace(scene.render.filepath, target)


def render_job(job, settings, lens, rig, target, seed_of=""):
    camera = rig[job.camera]
    plan = cameras.render_plan(camera)
    lens.set_camera(camera, plan)
    _dress(job)
    if job.readout_s:
        lens.roll(camera, plan, job.world_from_body, job.exposure_s, job.readout_s)
    else:
        lens.still(job.world_from_body(job.exposure_s))
    start, cpu = time.time(), time.process_time()
    expose(target, job.seed_text + seed_of)
    seconds = f"{time.time() - start:.1f} s, {time.process_time() - cpu:.1f} CPU s"
    print(f"JOB {job.key} {plan.size_px[0]}x{plan.size_px[1]} {seconds}", flush=True)


def open_scene(settings):
    bpy.ops.wm.open_mainfile(filepath=f"{settings.work}/street.blend")
    cycles_settings(settings.samples)


def render(settings):
    open_scene(settings)
    lens, rig = Lens(), cameras.rig(settings.size)
    for job in job_list.all_jobs(settings):
        target = job.render(settings)
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.exists():
            continue
        with open(f"{target}.lock", "w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue  # another process renders it
            if not target.exists():
                render_job(job, settings, lens, rig, target)
