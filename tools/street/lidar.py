# SPDX-License-Identifier: Apache-2.0
"""The spinning LiDAR: 10 Hz like the dataset's, with fewer channels (the dataset has 64 and 0.2 degrees)."""
POSITION_M = (1.1574, 0.0013, 1.6823)  # in the body, no rotation
ELEVATIONS_DEG = (15, 8, 4, 1, -1, -2, -3, -4.5, -6, -8, -10, -12.5, -15, -18, -21.5, -25)
REVOLUTION_S = 0.1
STEPS = 120  # packets a revolution, one azimuth each, clockwise; frames are 2/3 of it apart
RANGE_M, NEAR_M, RANGE_NOISE_M = 100.0, 1.0, 0.02
