# SPDX-License-Identifier: Apache-2.0
"""The spinning LiDAR: 10 Hz as the dataset's, thinned (that one has 64 beams and 0.2 degrees)."""
POSITION_M = (1.1574, 0.0013, 1.6823)   # in the body, no rotation
ELEVATIONS_DEG = (15, 11, 8, 5, 3.5, 2, 1, 0, -1, -2, -3, -4, -5, -6, -7.5, -9, -10.5, -12, -14, -16, -18, -20, -22.5, -25)
REVOLUTION_S = 0.1
STEPS = 150                                      # packets a revolution, one azimuth each, clockwise from ahead
RANGE_M, NEAR_M, RANGE_NOISE_M = 100.0, 1.0, 0.02
