# SPDX-License-Identifier: Apache-2.0
"""The spinning LiDAR: 10 Hz like the dataset's, with fewer channels (the dataset has 64 and 0.2 degrees)."""
import numpy as np

POSITION_M = (1.1574, 0.0013, 1.6823)  # in the body, no rotation
ELEVATIONS_DEG = (15, 8, 4, 1, -1, -2, -3, -4.5, -6, -8, -10, -12.5, -15, -18, -21.5, -25)
REVOLUTION_S = 0.1
STEPS = 120  # packets a revolution, one azimuth each, clockwise; frames are 2/3 of it apart
RANGE_M, NEAR_M, RANGE_NOISE_M = 100.0, 1.0, 0.02
SEEN_REFLECTANCE, SEEN_AT_M = 0.1, 50.0  # detects pavement so far away, like an HDL-64E by its data sheet
INTENSITY_RANGE_M = 200.0  # intensities are corrected for the range but for 1/e over so far
POWER_NOISE = 0.08  # RMS, in the logarithm
GLOSS_EXPONENT = 60  # falls to a half within 9 degrees


def rays(step):
    """Returns the unit directions [channels, 3] of an azimuth step, a whole number or not, in the sensor's axes."""
    elevation, azimuth = np.radians(ELEVATIONS_DEG), -2 * np.pi * step / STEPS
    return np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], 1)


def reflected(diffuse, gloss, cosine):
    """Returns the light that a surface sends back, of a white one's that faces the sensor (Phong 1975)."""
    return diffuse * cosine + gloss * cosine**GLOSS_EXPONENT


def measure(distance_m, light, rng):
    """Returns whether each ray [n] has a return, its noisy range and its intensity, 0..255 for light of 0..1.

    A return is detected by its power, light / range^2. distance_m: inf where nothing was hit."""
    range_m = distance_m + rng.normal(0, RANGE_NOISE_M, len(distance_m))
    light = light * np.exp(rng.normal(0, POWER_NOISE, len(distance_m)))
    seen = np.isfinite(distance_m) & (distance_m > NEAR_M)
    seen &= light * SEEN_AT_M**2 >= SEEN_REFLECTANCE * np.where(seen, distance_m, 0) ** 2
    intensity = 255 * np.clip(light * np.exp(-np.where(seen, distance_m, 0) / INTENSITY_RANGE_M), 0, 1)
    return seen, range_m, np.round(intensity)
