# SPDX-License-Identifier: Apache-2.0
"""The three annotated vehicles of the traffic variant: one parked, one ahead, one oncoming."""
import math
from dataclasses import dataclass

import road

PARKED_T = 4.32  # |t| of parked cars
RESERVED_S = (29.0, 37.0)  # right-hand bay reserved for the parked vehicle
COLORS = (
    (0.55, 0.56, 0.58),
    (0.02, 0.02, 0.022),
    (0.62, 0.62, 0.60),
    (0.30, 0.02, 0.02),
    (0.03, 0.07, 0.22),
    (0.18, 0.19, 0.20),
    (0.05, 0.14, 0.09),
    (0.45, 0.35, 0.20),
    (0.07, 0.20, 0.34),
    (0.38, 0.06, 0.03),
)
TYPE_NAMES = {"hatch": "CAR", "sedan": "CAR", "van": "VAN"}
BOUNDS = {  # least and greatest corner of a car in its frame, metres; vehicles.py compares them with its meshes
    "hatch": ((-2.010, -1.019, 0.0), (2.020, 1.019, 1.480)),
    "sedan": ((-2.310, -1.048, 0.0), (2.320, 1.048, 1.440)),
    "van": ((-2.485, -1.104, 0.0), (2.495, 1.104, 1.970)),
}


@dataclass(frozen=True)
class Vehicle:
    """Drives along a line of constant t at constant speed."""

    object_id: int
    kind: str
    color: tuple
    s: float  # at the first frame
    t: float
    speed: float  # along s, m/s; negative: oncoming

    @property
    def bounds(self):
        return BOUNDS[self.kind]

    def world_from_car(self, time_s):
        return road.frame(self.s + self.speed * time_s, self.t, turn=math.pi if self.speed < 0 else 0.0)


TRAFFIC = (
    Vehicle(1, "hatch", COLORS[3], 33.0, -PARKED_T, 0.0),
    Vehicle(2, "sedan", COLORS[8], 27.0, -road.LANE_T - 0.05, 9.2),
    Vehicle(3, "van", COLORS[2], 58.0, road.LANE_T, -9.8),
)
