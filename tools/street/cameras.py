# SPDX-License-Identifier: Apache-2.0
"""The rig, its exact camera models, and the resampling from Blender's lens to them.

Blender renders through its polynomial fisheye lens, angle(radius), fitted to the camera's own angle(distorted radius):
the render is the distorted image up to a scale and fractions of a pixel, which `to_render` states exactly. Rows of
the render are rows of the image (within the tangential distortion), as a rolling shutter requires.

Pixels: integer coordinates are pixel centres. Camera axes: x right, y down, z ahead.
"""
import math
from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Camera:
    name: str
    model: str  # opencv_pinhole | mei
    size_px: tuple  # width, height
    focal_px: tuple  # fx, fy
    center_px: tuple  # cx, cy
    distortion: tuple  # k1 k2 p1 p2 k3
    position_m: tuple  # in the body
    yaw_pitch_roll_deg: tuple  # aiMotive: yaw > 0 right, pitch > 0 up, roll > 0 lifts the right-hand side
    xi: float = 0.0  # mei

    def scaled(self, factor):
        grow = lambda c: (c + 0.5) * factor - 0.5
        return replace(
            self,
            size_px=tuple(round(v * factor) for v in self.size_px),
            focal_px=tuple(v * factor for v in self.focal_px),
            center_px=tuple(map(grow, self.center_px)),
        )

    def body_from_camera(self):
        yaw, pitch, roll = np.radians(self.yaw_pitch_roll_deg)
        ahead = np.array([math.cos(pitch) * math.cos(yaw), -math.cos(pitch) * math.sin(yaw), math.sin(pitch)])
        level_right = np.array([-math.sin(yaw), -math.cos(yaw), 0.0])
        right = math.cos(roll) * level_right - math.sin(roll) * np.cross(ahead, level_right)
        m = np.eye(4)
        m[:3, :3] = np.stack([right, np.cross(ahead, right), ahead], 1)
        m[:3, 3] = self.position_m
        return m


# Focal lengths, distortion and extrinsics in proportion to the dataset's cameras, at other sizes.
RIG = (
    Camera(
        "F_MIDLONGRANGECAM_CL",
        "opencv_pinhole",
        (480, 264),
        (439.1, 375.4),
        (240.2, 131.3),
        (-0.30073606967926025, 0.08419033139944077, 0.002034867648035288, 0.0006097130244597793, 0.0),
        (1.9311, 0.1072, 1.2488),
        (1.278, 0.491, -0.416),
    ),
    Camera(
        "F_MIDRANGECAM_C",
        "opencv_pinhole",
        (416, 256),
        (220.0, 221.1),
        (208.3, 127.2),
        (-0.2, 0.03, -0.0005, 0.0008, 0.0),
        (1.9, -0.1, 1.3),
        (-0.8, -1.1, 0.25),
    ),
    Camera(
        "M_FISHEYE_L",
        "mei",
        (400, 220),
        (179.8, 156.6),
        (200.6, 107.7),
        (0.03364013761086061, -0.08420780755924384, 0.0, 0.0, 0.0),
        (1.0572, 0.6379, 1.4145),
        (-92.198, -23.491, -0.96),
        1.0222136193840399,
    ),
    Camera(
        "M_FISHEYE_R",
        "mei",
        (400, 220),
        (180.0, 157.2),
        (201.1, 107.8),
        (0.02733074511706634, -0.0807192774510606, 0.0, 0.0, 0.0),
        (1.0563, -0.6378, 1.4145),
        (93.297, -23.618, -0.2),
        1.017479743852224,
    ),
)
FRONT_CAMERAS = ("F_MIDLONGRANGECAM_CL", "F_MIDRANGECAM_C")
NOVEL_CAMERA = "F_MIDLONGRANGECAM_CL"
SUPERSAMPLING = 1.25  # rendered pixels a pixel, each way
BONNET_CAMERA = "F_MIDRANGECAM_C"  # the one camera that sees the ego vehicle


def rig(size):
    return {c.name: c.scaled(size) for c in RIG}


def distort(x, y, coefficients):
    """OpenCV's radial and tangential distortion of the normalised image plane."""
    k1, k2, p1, p2, k3 = coefficients
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y)


def fold_radius(coefficients):
    """Returns the undistorted radius up to which the radial distortion grows; 10 if it always does."""
    k1, k2, _, _, k3 = coefficients
    roots = np.roots([7 * k3, 5 * k2, 3 * k1, 1.0])
    real = [z.real for z in roots if abs(z.imag) < 1e-12 and z.real > 0]
    return math.sqrt(min(real)) if real else 10.0


def undistort(xd, yd, coefficients):
    """Returns the inverse of distort, and where it exists (inside the fold)."""
    k1, k2, p1, p2, k3 = coefficients
    r = np.linspace(0, fold_radius(coefficients), 4001)
    r2 = r * r
    rd_table = r * (1 + r2 * (k1 + r2 * (k2 + r2 * k3)))
    rd = np.hypot(xd, yd)
    inside = rd < rd_table[-1]
    scale = np.interp(rd, rd_table, r) / np.maximum(rd, 1e-12)
    x, y = np.where(rd > 1e-9, xd * scale, xd), np.where(rd > 1e-9, yd * scale, yd)
    for _ in range(20):  # Newton, Jacobian of the distortion
        fx, fy = distort(x, y, coefficients)
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3))
        a = radial + x * x * slope + 2 * p1 * y + 6 * p2 * x
        b = x * y * slope + 2 * p1 * x + 2 * p2 * y
        d = radial + y * y * slope + 6 * p1 * y + 2 * p2 * x
        det = np.where(inside, a * d - b * b, 1.0)
        det = np.where(abs(det) < 1e-6, 1e-6, det)
        ex, ey = np.where(inside, xd - fx, 0.0), np.where(inside, yd - fy, 0.0)
        dx, dy = (d * ex - b * ey) / det, (a * ey - b * ex) / det
        damp = np.maximum(1, np.hypot(dx, dy) / 0.1)
        x, y = x + dx / damp, y + dy / damp
    return x, y, inside


def project(camera, points):
    """Projects [n, 3] points in the camera to [n, 2] pixels."""
    p = np.asarray(points, float)
    if camera.model == "mei":
        p = p / np.linalg.norm(p, axis=1, keepdims=True) + np.array([0, 0, camera.xi])
    xd, yd = distort(p[:, 0] / p[:, 2], p[:, 1] / p[:, 2], camera.distortion)
    return np.stack([xd * camera.focal_px[0] + camera.center_px[0], yd * camera.focal_px[1] + camera.center_px[1]], 1)


def unproject(camera, u, v):
    """Returns unit rays [..., 3] in the camera for pixels of any shape, and whether each is in the valid region."""
    xd, yd = (u - camera.center_px[0]) / camera.focal_px[0], (v - camera.center_px[1]) / camera.focal_px[1]
    x, y, inside = undistort(xd, yd, camera.distortion)
    if camera.model == "mei":
        r2, xi = x * x + y * y, camera.xi
        root = 1 + (1 - xi * xi) * r2
        inside = inside & (root > 0)
        a = (xi + np.sqrt(np.maximum(root, 0))) / (r2 + 1)
        rays = np.stack([a * x, a * y, a - xi], -1)
    else:
        rays = np.stack([x, y, np.ones_like(x)], -1)
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True), inside


@dataclass(frozen=True)
class RenderPlan:
    """Blender's fisheye image for a camera: angle = sum_k polynomial[k] radius^(k+1), radius in its own pixels."""

    size_px: tuple
    polynomial: tuple
    scale: float  # its pixels a unit of normalised distorted radius
    max_radius_px: float


def render_plan(camera, supersampling=SUPERSAMPLING):
    width, height = camera.size_px
    v, u = np.mgrid[-0.5 : height - 0.5 : 61j, -0.5 : width - 0.5 : 81j]
    rays, inside = unproject(camera, u, v)
    angle = np.arctan2(np.hypot(rays[..., 0], rays[..., 1]), rays[..., 2])[inside]
    scale = supersampling * math.sqrt(camera.focal_px[0] * camera.focal_px[1])
    xd, yd = (u - camera.center_px[0]) / camera.focal_px[0], (v - camera.center_px[1]) / camera.focal_px[1]
    radius = (scale * np.hypot(xd, yd))[inside]
    reach = radius.max()
    near = radius < (0.97 if camera.model == "mei" else 1.0) * reach  # the slope is infinite at the fold
    basis = np.stack([(radius[near] / reach) ** k for k in (1, 2, 3, 4)], 1)
    fit = np.linalg.lstsq(basis, angle[near], rcond=None)[0]
    polynomial = tuple(fit / reach ** np.arange(1, 5))
    plan = RenderPlan((2, 2), polynomial, scale, 1.3 * reach)
    px, py = _radial(plan, rays[inside])
    return replace(plan, size_px=tuple(2 * math.ceil(abs(p).max() + 4) for p in (px, py)))


def _radial(plan, rays):
    radius = np.linspace(0, plan.max_radius_px, 20001)
    table = sum(c * radius ** (k + 1) for k, c in enumerate(plan.polynomial))
    rising = np.concatenate([[True], np.diff(np.maximum.accumulate(table)) > 0])
    angle = np.arctan2(np.hypot(rays[..., 0], rays[..., 1]), rays[..., 2])
    rho = np.interp(angle, table[rising], radius[rising])
    across = np.maximum(np.hypot(rays[..., 0], rays[..., 1]), 1e-12)
    return rho * rays[..., 0] / across, rho * rays[..., 1] / across


def to_render(plan, rays):
    """Returns column and row in the rendered image of unit rays [..., 3] in the camera (integers: pixel centres)."""
    px, py = _radial(plan, rays)
    return plan.size_px[0] / 2 + px - 0.5, plan.size_px[1] / 2 + py - 0.5


def self_test():
    """Checks pixel -> ray -> pixel to 1e-6 px in the valid region."""
    for camera in RIG:
        v, u = np.mgrid[0 : camera.size_px[1] : 7, 0 : camera.size_px[0] : 7].astype(float)
        rays, inside = unproject(camera, u, v)
        back = project(camera, rays[inside])
        error = np.hypot(back[:, 0] - u[inside], back[:, 1] - v[inside])
        assert inside.mean() > 0.8 and error.max() < 1e-6, (camera.name, inside.mean(), error.max())
        m = camera.body_from_camera()
        assert abs(np.linalg.det(m[:3, :3]) - 1) < 1e-12 and m[2, 1] < -0.5, camera.name
        plan = render_plan(camera)
        x, y = to_render(plan, rays[inside])
        assert x.min() > 0 and y.min() > 0 and x.max() < plan.size_px[0] - 1 and y.max() < plan.size_px[1] - 1
        print(
            f"{camera.name:22} reaches {100 * inside.mean():.1f} % of its pixels, round trip {error.max():.1e} px, "
            f"render {plan.size_px[0]}x{plan.size_px[1]}"
        )
