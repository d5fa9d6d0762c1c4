# SPDX-License-Identifier: Apache-2.0
"""The street's own coordinates: s metres along the centre line, t metres to the left of it.

World: x ahead at s = 0, y left, z up, metres. A carriageway of two lanes and two parking lanes lies between the
kerbs; pavements lead from there to the facades.
"""
import numpy as np

KERB_T = 5.45  # |t| of the kerb's face
FACADE_T = 8.25  # |t| of the house fronts
LANE_T = 1.65  # |t| of a lane's middle
LANE_EDGE_T = 3.3  # lane | parking
START_S = -60
RADIUS_M = 170.0  # radius of the bends
BEND_PERIOD_M = 140.0

_STEP = 0.05
_S = np.arange(-200.0, 3000.0, _STEP)


def smoothstep(x, a, b):
    f = np.clip((x - a) / (b - a), 0, 1)
    return f * f * (3 - 2 * f)


def _curvature():
    """Right bend from s = 20 to 115, left bend 140 m further, and so on."""
    kappa = np.zeros_like(_S)
    for k in range(21):
        s = _S - k * BEND_PERIOD_M
        kappa += (-1) ** (k + 1) * (smoothstep(s, 20, 40) - smoothstep(s, 90, 115)) / RADIUS_M
    return kappa


_KAPPA = _curvature()
_ZERO = int(np.argmin(abs(_S)))
_PSI = np.cumsum(_KAPPA) * _STEP
_PSI -= _PSI[_ZERO]
_X = np.cumsum(np.cos(_PSI)) * _STEP
_Y = np.cumsum(np.sin(_PSI)) * _STEP
_X -= _X[_ZERO]
_Y -= _Y[_ZERO]


def end_s(frames):
    """Length of the street that is built for a recording of so many frames."""
    return int(230 + max(0, frames - 48) * 0.6)


def heading(s):
    return np.interp(s, _S, _PSI)


def curvature(s):
    return float(np.interp(s, _S, _KAPPA))


def xy(s, t):
    psi = heading(s)
    return np.interp(s, _S, _X) - t * np.sin(psi), np.interp(s, _S, _Y) + t * np.cos(psi)


def profile_z(s):
    """Height of the centre line."""
    return 0.003 * s + 0.04 * np.sin(np.asarray(s) / 20.0)


def cross_z(t):
    """Height of the surface above the centre line: cambered carriageway, kerb of 13 cm, pavement that falls to it."""
    a = abs(t)
    if a <= KERB_T + 1e-6:
        return -0.02 * a
    return 0.02 + 0.015 * (a - KERB_T)


def point(s, t, z):
    """World point; z above the centre line's height."""
    x, y = xy(s, t)
    return float(x), float(y), float(z + profile_z(s))


def ground_point(s, t, lift=0.0):
    return point(s, t, cross_z(t) + lift)


def frame(s, t, z=None, turn=0.0):
    """4x4 world_from_local: origin at (s, t, z above the centre line; the surface by default), x along the street,
    y left, then turned about z by `turn` radians."""
    x, y = xy(s, t)
    psi = float(heading(s)) + turn
    m = np.eye(4)
    m[:2, :2] = [[np.cos(psi), -np.sin(psi)], [np.sin(psi), np.cos(psi)]]
    m[:3, 3] = [x, y, (cross_z(t) if z is None else z) + profile_z(s)]
    return m


def side_frame(side, s, t_abs, z=None, turn=0.0):
    """A frame at |t| = t_abs on the left (side = 1) or right (-1) whose y axis points to the street's middle."""
    return frame(s, side * t_abs, z, (np.pi if side > 0 else 0.0) + turn)
