# SPDX-License-Identifier: Apache-2.0
"""The library of materials: name -> Blender material. Colours are linear reflectances."""
import bpy
import numpy as np

import textures
from shading import Shader

WALLS = (
    "brick_red",
    "plaster_cream",
    "brick_yellow",
    "plaster_ochre",
    "plaster_grey",
    "brick_brown",
    "plaster_pink",
    "stone_block",
    "plaster_green",
    "plaster_white",
    "brick_red",
    "plaster_blue",
)
GLASS = ("glass_a", "glass_a", "glass_b", "glass_c", "blinds", "curtain", "curtain")

# Flat reflectance for bounced light, by the beginning of the material's name.
FLAT = {
    "glass": (0.05, 0.05, 0.055),
    "car": (0.2, 0.2, 0.2),
    "leaf": (0.09, 0.14, 0.03),
    "asphalt": (0.12, 0.12, 0.115),
    "plaster": (0.5, 0.46, 0.38),
    "brick": (0.3, 0.19, 0.13),
    "stone": (0.33, 0.31, 0.28),
    "slabs": (0.31, 0.30, 0.28),
    "trim": (0.5, 0.48, 0.44),
    "paint": (0.6, 0.6, 0.57),
    "sign_white": (0.7, 0.7, 0.7),
    "plate": (0.7, 0.7, 0.7),
}
FLAT_ELSE = (0.25, 0.24, 0.22)

# Shares of a LiDAR's light (905 nm) that a surface scatters and that it mirrors, by the first of these that the
# material's name begins with. Car paint scatters as much as its colour; above 1: retroreflective.
LIDAR_REFLECTANCE = {
    "asphalt_patch": (0.09, 0.0),
    "asphalt": (0.15, 0.0),
    "paint": (0.6, 0.0),  # lane markings
    "plaster": (0.55, 0.0),
    "leaf": (0.5, 0.0),
    "glass": (0.004, 0.5),
    "carglass": (0.004, 0.5),
    "carpaint": (None, 0.2),
    "carplastic": (0.05, 0.0),
    "tyre": (0.04, 0.0),
    "seam": (0.02, 0.0),
    "metal": (0.2, 0.3),
    "trim_dark": (0.1, 0.0),
    "roof": (0.2, 0.0),
    "soil": (0.2, 0.0),
    "lamp": (1.5, 0.0),
    "plate": (20.0, 0.0),
    "sign_black": (0.04, 0.0),
    "sign": (0.6, 0.0),
}
LIDAR_REFLECTANCE_ELSE = (0.33, 0.0)  # brick, stone, wood


def lidar_reflectance(name, color):
    """Returns what a material scatters and mirrors; color: the object's, linear."""
    fits = (v for start, v in LIDAR_REFLECTANCE.items() if name.startswith(start))
    diffuse, gloss = next(fits, LIDAR_REFLECTANCE_ELSE)
    return float(np.mean(color[:3])) if diffuse is None else diffuse, gloss


BRICKS = {  # two brick colours, mortar, width, height, joint, stain
    "brick_red": ((0.36, 0.10, 0.06), (0.24, 0.075, 0.05), (0.42, 0.39, 0.35), 0.23, 0.078, 0.012, 0.35),
    "brick_brown": ((0.21, 0.11, 0.06), (0.32, 0.17, 0.09), (0.30, 0.28, 0.25), 0.23, 0.078, 0.012, 0.35),
    "brick_yellow": ((0.52, 0.38, 0.19), (0.42, 0.29, 0.14), (0.46, 0.43, 0.38), 0.23, 0.078, 0.012, 0.35),
    "stone_block": ((0.44, 0.41, 0.35), (0.34, 0.32, 0.28), (0.16, 0.15, 0.14), 0.82, 0.36, 0.018, 0.25),
    "stone_dark": ((0.20, 0.19, 0.18), (0.27, 0.25, 0.23), (0.09, 0.09, 0.09), 0.60, 0.30, 0.016, 0.25),
    "kerb": ((0.50, 0.48, 0.45), (0.42, 0.41, 0.38), (0.14, 0.13, 0.12), 1.00, 0.80, 0.015, 0.20),
    "roof_tile": ((0.33, 0.12, 0.07), (0.24, 0.09, 0.06), (0.10, 0.05, 0.04), 0.20, 0.28, 0.020, 0.30),
}
PLASTERS = {
    "plaster_ochre": (0.62, 0.42, 0.17),
    "plaster_cream": (0.68, 0.60, 0.44),
    "plaster_pink": (0.60, 0.36, 0.29),
    "plaster_green": (0.34, 0.45, 0.31),
    "plaster_grey": (0.46, 0.47, 0.47),
    "plaster_blue": (0.33, 0.43, 0.53),
    "plaster_white": (0.76, 0.74, 0.69),
}
PLAIN = {  # colour, variation, its scale, then mirror, roughness, index where it shines
    "trim_white": ((0.74, 0.73, 0.70), 0.10, 5),
    "trim_stone": ((0.50, 0.47, 0.41), 0.2, 4),
    "trim_dark": ((0.09, 0.085, 0.08), 0.3, 5),
    "wood_brown": ((0.20, 0.10, 0.045), 0.45, 12),
    "wood_green": ((0.06, 0.16, 0.10), 0.3, 8),
    "wood_red": ((0.30, 0.05, 0.04), 0.3, 8),
    "metal_grey": ((0.30, 0.31, 0.32), 0.2, 8, 0.05, 0.35, 1.4),
    "metal_dark": ((0.05, 0.06, 0.06), 0.3, 8, 0.03, 0.35, 1.4),
    "kerb_base": ((0.5, 0.49, 0.46), 0.2, 3),
    "roof_flat": ((0.16, 0.16, 0.165), 0.3, 1.5),
    "concrete": ((0.40, 0.39, 0.37), 0.3, 1.2),
    "pebble_light": ((0.46, 0.43, 0.39), 0.4, 9),
    "pebble_dark": ((0.22, 0.20, 0.18), 0.4, 9),
    "soil": ((0.10, 0.07, 0.045), 0.6, 9),
    "carglass": ((0.015, 0.018, 0.02), 0.3, 2, 0.05, 0.03, 1.5),
    "tyre": ((0.025, 0.025, 0.025), 0.4, 20),
    "carplastic": ((0.04, 0.04, 0.042), 0.2, 10),
    "alloy": ((0.42, 0.43, 0.44), 0.2, 10, 0.12, 0.25, 1.4),
    "lamp_white": ((0.75, 0.76, 0.76), 0.1, 12, 0.1, 0.1, 1.4),
    "lamp_red": ((0.42, 0.02, 0.02), 0.2, 12, 0.05, 0.1, 1.4),
    "lamp_amber": ((0.60, 0.25, 0.02), 0.2, 12, 0.05, 0.1, 1.4),
    "plate": ((0.78, 0.78, 0.74), 0.05, 5),
    "seam": ((0.012, 0.012, 0.012), 0.1, 5),
    "sign_red": ((0.55, 0.03, 0.03), 0.08, 9),
    "sign_blue": ((0.03, 0.12, 0.45), 0.08, 9),
    "sign_yellow": ((0.75, 0.50, 0.05), 0.08, 9),
    "sign_green": ((0.03, 0.26, 0.12), 0.08, 9),
    "sign_black": ((0.03, 0.03, 0.03), 0.08, 9),
    "sign_white": ((0.78, 0.78, 0.76), 0.08, 9),
}
LEAVES = {
    "leaf_a": ((0.035, 0.10, 0.018), (0.14, 0.21, 0.035)),
    "leaf_b": ((0.05, 0.12, 0.02), (0.22, 0.24, 0.05)),
    "leaf_c": ((0.02, 0.07, 0.02), (0.08, 0.15, 0.04)),
}
ASPHALT = {
    "asphalt": (0.115, 0.113, 0.110),
    "asphalt_patch": (0.055, 0.055, 0.057),
    "asphalt_old": (0.165, 0.160, 0.150),
}


def _brick(m, color1, color2, mortar, width, height, joint, stain):
    at = m.uv()
    color = m.times(
        m.brick(at, color1, color2, mortar, width, height, joint), m.ramp(m.noise(at, 0.7, 4), 1 - stain, 1 + stain)
    )
    color = m.times(color, m.ramp(m.noise(m.uv((5.0, 0.35, 1)), 1.0, 2), 0.82, 1.1))  # rain streaks
    return m.diffuse(m.times(color, m.ramp(m.noise(at, 23.0, 1), 0.8, 1.2)))


def _plaster(m, color, stain=0.28):
    at = m.uv()
    color = m.times(color, m.ramp(m.noise(at, 0.45, 5, 0.65), 1 - stain, 1 + stain * 0.6))
    color = m.times(color, m.ramp(m.noise(m.uv((3.5, 0.22, 1)), 1.0, 3), 0.72, 1.08, 0.35, 0.6))
    color = m.times(color, m.ramp(m.noise(at, 14.0, 3, 0.7), 0.82, 1.15))
    cracks = m.voronoi(m.warped(at, 2.2, 3.0), 0.55, "DISTANCE_TO_EDGE").outputs["Distance"]
    return m.diffuse(m.times(color, m.ramp(cracks, 0.62, 1.0, 0.0, 0.012)))


def _plain(m, color, variation, scale, mirror=None, roughness=0.3, index=1.4):
    color = m.times(color, m.ramp(m.noise(m.uv(), scale, 3), 1 - variation, 1 + variation))
    return m.diffuse(color) if mirror is None else m.coated(color, mirror, roughness, index)


def _asphalt(m, base, cracked):
    at = m.uv()
    stones = m.voronoi(at, 70.0, "F1")
    grain = m.node("SeparateColor", {0: stones.outputs["Color"]}).outputs[0]
    color = m.times(base, m.ramp(grain, 0.62, 1.45, 0, 1))
    color = m.times(color, m.ramp(stones.outputs["Distance"], 1.25, 0.7, 0.1, 0.75))
    color = m.times(color, m.ramp(m.noise(at, 3.2, 4, 0.65), 0.74, 1.28))
    color = m.times(color, m.ramp(m.noise(m.uv((0.10, 0.9, 1)), 1.0, 3), 0.72, 1.25))  # wheel tracks
    if cracked:
        edge = m.voronoi(m.warped(at, 1.6, 4.0), 0.42, "DISTANCE_TO_EDGE").outputs["Distance"]
        whole = m.ramp(m.noise(at, 0.35, 1), 1, 0, 0.45, 0.55)
        color = m.times(color, m.maximum(m.ramp(edge, 0.35, 1.0, 0.003, 0.010), whole))
    return m.diffuse(color)


def _road_paint(m):
    at = m.uv()
    worn = m.ramp(m.noise(at, 7.0, 4, 0.7), 0, 1, 0.36, 0.46)
    return m.diffuse(
        m.times(m.mix(worn, (0.15, 0.148, 0.14), (0.66, 0.65, 0.62)), m.ramp(m.noise(at, 45, 1), 0.75, 1.15))
    )


def _slabs(m):
    at = m.uv()
    color = m.brick(at, (0.36, 0.345, 0.32), (0.27, 0.262, 0.25), (0.09, 0.088, 0.08), 0.5, 0.5, 0.010)
    color = m.times(color, m.ramp(m.noise(at, 1.1, 4), 0.7, 1.25))
    color = m.times(color, m.ramp(m.noise(at, 38, 2, 0.7), 0.72, 1.22))
    spots = m.voronoi(at, 2.1, "F1").outputs["Distance"]
    return m.diffuse(m.times(color, m.ramp(spots, 0.5, 1, 0.05, 0.07)))


def _poster(m, index, rng):
    pixels = textures.poster(index, rng)
    image = bpy.data.images.new(f"poster{index}", pixels.shape[1], pixels.shape[0])
    rgba = np.ones((*pixels.shape[:2], 4), np.float32)
    rgba[..., :3] = pixels[::-1]
    image.pixels.foreach_set(rgba.ravel())
    image.pack()
    at = m.uv()
    color = m.node("TexImage", {"Vector": at}, image=image).outputs["Color"]
    return m.diffuse(m.times(color, m.ramp(m.noise(at, 4, 2), 0.85, 1.0)))


def _bands(m, direction, dark, light, scale, distortion=0.0):
    wave = m.node(
        "TexWave",
        {"Vector": m.uv(), "Scale": scale, "Distortion": distortion},
        wave_type="BANDS",
        bands_direction=direction,
    ).outputs["Fac"]
    return m.coated(m.mix(wave, dark, light), 0.0, 0.05, 1.3)


def make_materials(settings):
    out = {}

    def add(name, make, *args):
        flat = next((c for start, c in FLAT.items() if name.startswith(start)), FLAT_ELSE)
        out[name] = make(Shader(name, flat), *args)

    for name, args in BRICKS.items():
        add(name, _brick, *args)
    for name, color in PLASTERS.items():
        add(name, _plaster, color)
    for name, args in PLAIN.items():
        add(name, _plain, *args)
    for name, color in ASPHALT.items():
        add(name, _asphalt, color, name != "asphalt_patch")
    add("paint", _road_paint)
    add("slabs", _slabs)
    for name, color in (
        ("glass_a", (0.020, 0.026, 0.032)),
        ("glass_b", (0.045, 0.05, 0.052)),
        ("glass_c", (0.075, 0.07, 0.062)),
    ):
        add(name, lambda m, c: m.coated(m.times(c, m.ramp(m.noise(m.uv(), 1.3, 2), 0.3, 2.2)), 0.03, 0.03, 1.5), color)
    add("blinds", _bands, "Y", (0.16, 0.15, 0.13), (0.50, 0.47, 0.41), 2.4)
    add("curtain", _bands, "X", (0.20, 0.19, 0.18), (0.58, 0.55, 0.50), 3.2, 1.4)
    for name, colors in LEAVES.items():
        add(name, lambda m, a, b: m.leaf(m.mix(m.node("NewGeometry").outputs["Random Per Island"], a, b)), *colors)
    add(
        "bark",
        lambda m: m.diffuse(m.times((0.17, 0.125, 0.085), m.ramp(m.noise(m.uv((6, 1.2, 1)), 2.0, 5, 0.7), 0.35, 1.7))),
    )
    add("carpaint", lambda m: m.coated(m.node("ObjectInfo").outputs["Color"], 0.03, 0.07, 1.45))
    add(
        "awning",
        lambda m: m.diffuse(
            m.node(
                "TexChecker",
                {
                    "Vector": m.uv((3.6, 0.0001, 1)),
                    "Scale": 1.0,
                    "Color1": (0.70, 0.68, 0.62),
                    "Color2": (0.42, 0.05, 0.05),
                },
            ).outputs["Color"]
        ),
    )
    for index in range(textures.POSTERS):
        add(f"poster{index}", _poster, index, settings.np_rng("poster", index))
    return out
