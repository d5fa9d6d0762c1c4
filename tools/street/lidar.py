# SPDX-License-Identifier: Apache-2.0
"""The spinning LiDAR: 10 Hz as the dataset's, thinned (that one has 64 beams and 0.2 degrees)."""
POSITION_M = (1.1574, 0.0013, 1.6823)  # in the body, no rotation
ELEVATIONS_DEG = (15, 10, 6, 3, 1.5, 0, -1, -2, -3, -4, -5, -6.5, -8, -10, -12, -14, -16.5, -19, -22, -25)
REVOLUTION_S = 0.1
STEPS = 120  # packets a revolution, one azimuth each, clockwise; frames are 2/3 of it apart
RANGE_M, NEAR_M, RANGE_NOISE_M = 100.0, 1.0, 0.02
