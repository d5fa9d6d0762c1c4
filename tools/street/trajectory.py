# SPDX-License-Identifier: Apache-2.0
"""The exact trajectory of the car, and the errors of the egomotion file."""
import math

import numpy as np

import road
from settings import FRAME_RATE_HZ, Settings, frame_time_s

SPEED_M_S = 8.0
START_S = 12.0
POSE_NOISE_M = (0.06, 0.06, 0.03)  # along, left, up: RMS
POSE_NOISE_DEG = 0.12  # about each axis: RMS
NOISE_CORRELATION_S = 0.7
YAW_ERROR_DEG = {"F_MIDRANGECAM_C": 0.15}  # in calibration.json, not in calibration_true.json
TIME_OFFSET_S = {"M_FISHEYE_L": -0.012}  # exposed so much after the pose's time (negative: before)


def _s(t):
    return START_S + SPEED_M_S * t + 0.25 * math.sin(1.7 * t)


def _t(t):
    return -road.LANE_T + 0.16 * math.sin(2 * math.pi * t / 2.9 + 0.4) + 0.05 * math.sin(2 * math.pi * t / 1.3)


def rotation(yaw, pitch_up, roll_left_up):
    cy, sy, cp, sp = math.cos(yaw), math.sin(yaw), math.cos(-pitch_up), math.sin(-pitch_up)
    cr, sr = math.cos(roll_left_up), math.sin(roll_left_up)
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    return about_z @ about_y @ about_x


def world_from_body(t):
    """Returns the body pose t seconds after the first frame. Body: x ahead, y left, z up, origin at the rear axle."""
    wave = lambda amplitude, period, phase=0.0: amplitude * math.sin(2 * math.pi * t / period + phase)
    here, step = np.array(road.xy(_s(t), _t(t))), 0.02
    ahead = np.array(road.xy(_s(t + step), _t(t + step))) - np.array(road.xy(_s(t - step), _t(t - step)))
    s = _s(t)
    slope = float(road.profile_z(s + 1.4) - road.profile_z(s - 1.4)) / 2.8
    m = np.eye(4)
    m[:3, :3] = rotation(
        math.atan2(ahead[1], ahead[0]),
        slope + math.radians(wave(0.22, 0.9, 1.0) + wave(0.10, 0.37)),
        math.radians(wave(0.30, 1.25, 0.3) + 0.25),
    )
    m[:2, 3] = here
    m[2, 3] = float(road.profile_z(s)) + road.cross_z(_t(t)) + wave(0.008, 0.8)
    return m


def shifted(world_from_body_, shift_m, yaw_left_deg):
    """Returns a pose translated in its own axes by shift_m, then rotated to the left."""
    d = np.eye(4)
    d[:3, 3] = shift_m
    d[:3, :3] = rotation(math.radians(yaw_left_deg), 0, 0)
    return world_from_body_ @ d


def ecef_from_world():
    """Returns ECEF from world of an invented location: 47.5 N, 19.05 E, 120 m (WGS84); the first frame heads 30 degrees
    east of north."""
    a, flattening = 6378137.0, 1 / 298.257223563
    e2 = flattening * (2 - flattening)
    lat, lon, height = math.radians(47.5), math.radians(19.05), 120.0
    n = a / math.sqrt(1 - e2 * math.sin(lat) ** 2)
    up = np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])
    east = np.array([-math.sin(lon), math.cos(lon), 0.0])
    ecef_from_enu = np.eye(4)
    ecef_from_enu[:3, :3] = np.stack([east, np.cross(up, east), up], 1)
    ecef_from_enu[:3, 3] = (n + height) * up - np.array([0, 0, e2 * n * math.sin(lat)])
    first = world_from_body(0.0)
    turn = np.eye(4)
    turn[:3, :3] = rotation(math.radians(60.0) - math.atan2(first[1, 0], first[0, 0]), 0, 0)
    turn[:3, 3] = -turn[:3, :3] @ first[:3, 3]
    return ecef_from_enu @ turn


def pose_noise(settings: Settings, frames):
    """[frames, 6] metres and radians in body axes: Gaussian process with a squared-exponential correlation of 0.7 s,
    mean 0, scaled to the RMS above."""
    t = np.array([frame_time_s(i) for i in range(frames)])
    covariance = np.exp(-0.5 * ((t[:, None] - t[None]) / NOISE_CORRELATION_S) ** 2) + 1e-9 * np.eye(frames)
    noise = np.linalg.cholesky(covariance) @ settings.np_rng("pose noise").normal(size=(frames, 6))
    rms = np.array([*POSE_NOISE_M, *[math.radians(POSE_NOISE_DEG)] * 3])
    if frames >= FRAME_RATE_HZ:  # a shorter piece is too smooth to be centred
        noise -= noise.mean(0)
        return noise / np.sqrt((noise**2).mean(0)) * rms
    return noise * rms


def rotation_exp(w):
    """Rodrigues' formula."""
    angle = max(float(np.linalg.norm(w)), 1e-15)
    x, y, z = w / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * k + (1 - math.cos(angle)) * k @ k


def with_noise(pose, noise):
    m = pose.copy()
    m[:3, 3] += pose[:3, :3] @ noise[:3]
    m[:3, :3] = pose[:3, :3] @ rotation_exp(noise[3:])
    return m
