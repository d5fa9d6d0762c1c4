# SPDX-License-Identifier: Apache-2.0
"""The whole street as a Blender file: run inside Blender by street.py."""
import math

import bpy
import numpy as np
from mathutils import Vector

import facades
import furniture
import ground
import materials
import road
import textures
import trees
import vehicles
from mesh import Stage

SUN_STRENGTH, SUN_ANGLE_DEG, SUN_COLOR = 4.6, 0.5, (1.0, 0.95, 0.86)
SKY_STRENGTH = 1.15


def _sky(settings):
    sky = textures.sky(settings.np_rng("sky"))
    height, width = sky.shape[:2]
    image = bpy.data.images.new("sky", width, height, float_buffer=True)
    image.colorspace_settings.name = "Linear"
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = sky
    image.pixels.foreach_set(rgba.ravel())
    image.pack()
    world = bpy.data.worlds.new("sky")
    bpy.context.scene.world = world
    world.use_nodes = True
    tree = world.node_tree
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image = image
    background = tree.nodes["Background"]
    tree.links.new(texture.outputs[0], background.inputs[0])
    background.inputs[1].default_value = SKY_STRENGTH
    # The sky is smooth enough to be hit by bounces. As a sampled light it would take half of the sun's samples.
    world.cycles.sampling_method = "NONE"


def _sun():
    light = bpy.data.lights.new("sun", "SUN")
    light.energy, light.angle, light.color = SUN_STRENGTH, math.radians(SUN_ANGLE_DEG), SUN_COLOR
    sun = bpy.data.objects.new("sun", light)
    bpy.context.scene.collection.objects.link(sun)
    sun.rotation_mode = "QUATERNION"
    sun.rotation_quaternion = Vector(tuple(textures.sun_direction())).to_track_quat("Z", "Y")


def build(settings):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    stage = Stage(materials.make_materials(settings))
    end = road.end_s(settings.frames)
    for part in (ground, facades, trees, furniture, vehicles):
        part.build(stage, settings, end)
    _sky(settings)
    _sun()
    bpy.ops.wm.save_as_mainfile(filepath=f"{settings.work}/street.blend", compress=False)
    polygons = sum(len(o.data.polygons) for o in bpy.data.objects if o.type == "MESH")
    print(f"built: {len(bpy.data.objects)} objects, {polygons} polygons, {end - road.START_S} m of street")
