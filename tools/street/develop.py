# SPDX-License-Identifier: Apache-2.0
"""From Blender's linear image to the camera's: exact resampling and one fixed tone curve."""
import functools
import os

os.environ["OPENCV_IO_ENABLE_OPENEXR"] = "1"  # before the import below
import cv2  # noqa: E402
import numpy as np  # noqa: E402

import cameras  # noqa: E402

EXPOSURE = 1.08
SHOULDER = 0.6  # linear up to here, then an exponential roll-off to 1
BRIGHTEST = 2.0  # highlights are clipped at this radiance, so that the cubic filter cannot ring around them
JPEG_QUALITY = 88
CHANGE_BLUR_PX = 1.5  # averages the noise of paths that met the changed object later
LEAST_CHANGE = 4  # in 0..255
CHANGE_MARGIN_PX = 2


def read_exr(path):
    """Returns [h, w, 3] float32, BGR."""
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise OSError(f"{path}: not readable as EXR")
    return np.ascontiguousarray(image[..., :3], np.float32)


@functools.lru_cache(maxsize=8)
def _maps(camera):
    """Returns column, row in the render and a weight of 3 x 3 points of every pixel; 0 outside the valid region."""
    plan = cameras.render_plan(camera)
    v, u = np.mgrid[0 : camera.size_px[1], 0 : camera.size_px[0]].astype(float)
    maps = []
    for dv in (-1 / 3, 0, 1 / 3):
        for du in (-1 / 3, 0, 1 / 3):
            rays, inside = cameras.unproject(camera, u + du, v + dv)
            x, y = cameras.to_render(plan, rays)
            maps.append((x.astype(np.float32), y.astype(np.float32), inside.astype(np.float32)))
    return maps


def resample(camera, render):
    """Averages 3 x 3 points a pixel, cubic, in linear light. Pixels centred outside the valid region are black."""
    maps = _maps(camera)
    source = np.minimum(render, BRIGHTEST)
    total = np.zeros((*maps[0][0].shape, 3), np.float32)
    for x, y, weight in maps:
        total += weight[..., None] * cv2.remap(source, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    reached = sum(w for _, _, w in maps)
    return np.maximum(total, 0) / np.maximum(reached, 1)[..., None] * maps[4][2][..., None]


def tone(radiance):
    """Maps linear radiance to 8 bits: exposure, shoulder, sRGB transfer (IEC 61966-2-1)."""
    x = EXPOSURE * radiance
    x = np.where(x < SHOULDER, x, SHOULDER + (1 - SHOULDER) * (1 - np.exp(-(x - SHOULDER) / (1 - SHOULDER))))
    encoded = np.where(x < 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)
    return np.clip(np.round(255 * encoded), 0, 255).astype(np.uint8)


def write_image(path, image, *options):
    """Writes as cv2.imwrite, atomically."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(path.name + ".part")
    temporary.write_bytes(cv2.imencode(path.suffix, image, options)[1])
    temporary.replace(path)


def develop(camera, exr, jpeg):
    write_image(jpeg, tone(resample(camera, read_exr(exr))), cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY)


def changed(camera, exr, unedited_exr):
    """Returns [h, w], 255 where two renders with the same noise differ by more than the noise of indirect light."""
    a, b = (tone(resample(camera, read_exr(file))).astype(np.float32) for file in (exr, unedited_exr))
    difference = np.abs(cv2.GaussianBlur(a - b, (0, 0), CHANGE_BLUR_PX)).max(2)
    mask = np.where(difference > LEAST_CHANGE, 255, 0).astype(np.uint8)
    disc = lambda radius: cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2)
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, disc(2))
    return cv2.dilate(mask, disc(2 + CHANGE_MARGIN_PX))
