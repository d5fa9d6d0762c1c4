# SPDX-License-Identifier: Apache-2.0
"""Computed images: posters and the sky. numpy and OpenCV only."""
import math

import cv2
import numpy as np

POSTERS = 12
WORDS = ("OPERA", "KINO", "JAZZ", "EXPO 47", "MARKET", "RADIO", "CIRCUS", "TANGO", "METRO")
SUN_AZIMUTH_DEG, SUN_ELEVATION_DEG = 205.0, 50.0  # azimuth from world x towards y


def fractal_noise(size, rng, octaves=6, gain=0.55, base=4):
    """Returns value noise, size x size, in [0, 1]."""
    out, amplitude = np.zeros((size, size), np.float32), 1.0
    for octave in range(octaves):
        grid = rng.random((min(base * 2**octave, size) + 3,) * 2).astype(np.float32)
        out += amplitude * cv2.resize(grid, (size, size), interpolation=cv2.INTER_CUBIC)
        amplitude *= gain
    return (out - out.min()) / (out.max() - out.min())


def _pattern(kind, rng, h, w):
    y, x = np.mgrid[:h, :w]
    light, dark = rng.uniform(0.6, 0.95, 3), rng.uniform(0.02, 0.3, 3)
    blocks = lambda n, m, c: cv2.resize(
        rng.random((n, m, c)).astype(np.float32), (w, h), interpolation=cv2.INTER_NEAREST
    ).reshape(h, w, c)
    if kind == 0:
        mask = ((y // 32 + x // 32) % 2)[..., None]
    elif kind == 1:
        mask = blocks(48, 32, 1) > 0.5
    elif kind == 2:
        mask = (np.sin(np.arctan2(y - h * 0.42, x - w / 2) * 24) > 0)[..., None]
    elif kind == 3:
        return blocks(24, 16, 3)
    elif kind == 4:
        clouds = np.stack([fractal_noise(512, rng, 7, 0.7) for _ in range(3)], -1)
        return (cv2.resize(clouds, (w, h)) - 0.5) * 1.6 + 0.5
    else:
        image = np.where((y // 9 % 2)[..., None] > 0, light, dark).astype(np.float32)
        for _ in range(26):
            at = tuple(int(c) for c in rng.integers(0, (w, h)))
            cv2.circle(image, at, int(rng.integers(12, 60)), tuple(map(float, rng.uniform(0, 1, 3))), -1)
        return image
    return np.where(mask, light, dark)


def poster(index, rng):
    """[768, 512, 3] float, sRGB: a pattern, a title, small print."""
    h, w = 768, 512
    image = np.ascontiguousarray(np.clip(_pattern(index % 6, rng, h, w), 0.01, 0.97), np.float32)
    top = int(rng.integers(40, 90))
    color = lambda low, high: tuple(map(float, rng.uniform(low, high, 3)))
    cv2.rectangle(image, (0, top), (w, top + 130), color(0, 0.3), -1)
    cv2.putText(
        image,
        WORDS[index % len(WORDS)],
        (18, top + 100),
        cv2.FONT_HERSHEY_TRIPLEX,
        3.0,
        color(0.7, 1),
        8,
        cv2.LINE_AA,
    )
    letters = list("abcdefghijklmnopqrstuvwxyz    0123456789")
    for line in range(7):
        y = h - 190 + 26 * line
        cv2.rectangle(image, (24, y - 20), (w - 24, y + 4), (0.85, 0.85, 0.82), -1)
        cv2.putText(
            image,
            "".join(rng.choice(letters, 28)),
            (30, y),
            cv2.FONT_HERSHEY_SIMPLEX,
            0.75,
            (0.05, 0.05, 0.05),
            2,
            cv2.LINE_AA,
        )
    cv2.rectangle(image, (0, 0), (w - 1, h - 1), (0.9, 0.9, 0.9), 14)
    return image


def sun_direction():
    az, el = math.radians(SUN_AZIMUTH_DEG), math.radians(SUN_ELEVATION_DEG)
    return np.array([math.cos(el) * math.cos(az), math.cos(el) * math.sin(az), math.sin(el)])


def sky(rng, height=1024):
    """[height, 2 height, 3] linear radiance by latitude (bottom row: straight down) and longitude, as Blender's
    environment texture wants it: blue gradient, glow around the sun, clouds on a plane overhead."""
    lat = (np.arange(height) + 0.5) / height * math.pi - math.pi / 2
    lon = (np.arange(2 * height) + 0.5) / (2 * height) * 2 * math.pi - math.pi
    lat, lon = np.meshgrid(lat, lon, indexing="ij")
    d = np.stack([np.cos(lat) * np.cos(lon), -np.cos(lat) * np.sin(lon), np.sin(lat)], -1)
    up = np.maximum(d[..., 2:], 0)
    low = (1 - up) ** 3.2
    blue = np.array([0.13, 0.27, 0.62]) * (1 - low) + np.array([0.68, 0.76, 0.86]) * low
    blue = blue * (1 + 0.8 * np.maximum(d @ sun_direction(), 0)[..., None] ** 24)
    mirror = lambda q: np.abs(q % 4094 - 2047)  # folded instead of wrapped: no seams
    over = np.maximum(d[..., 2], 0.03) + 0.12
    noise = cv2.remap(
        fractal_noise(2048, rng, 9, 0.58, 5),
        mirror(d[..., 0] / over * 260 + 1000).astype(np.float32),
        mirror(d[..., 1] / over * 260 + 900).astype(np.float32),
        cv2.INTER_LINEAR,
    )[..., None]
    cover = np.clip((noise - 0.52) / 0.16, 0, 1)
    cover = 0.9 * cover * cover * (3 - 2 * cover) * np.clip(up / 0.06, 0, 1)
    cloud = 1.08 * np.array([1.0, 0.98, 0.96]) * np.clip(1.15 - (noise - 0.55) * 1.6, 0.62, 1.15)
    return np.where(d[..., 2:] < 0, np.array([0.22, 0.21, 0.20]), blue * (1 - cover) + cover * cloud)
