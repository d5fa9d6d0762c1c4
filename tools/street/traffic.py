# SPDX-License-Identifier: Apache-2.0
"""The three annotated vehicles of the traffic variant: one parked, one ahead, one oncoming; changes to them."""
import math
from dataclasses import dataclass

import numpy as np

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


@dataclass(frozen=True)
class Edit:
    """A change to one vehicle, as redrive's EDIT.json has it."""

    object_id: int
    shift_m: tuple = (0.0, 0.0, 0.0)  # along the axes of its box: ahead, left, up
    turn_deg: float = 0.0  # to the left, about the up axis through the box's centre
    remove: bool = False

    def to_json(self):
        change = {"remove": True} if self.remove else {}
        change |= {"shift_m": list(self.shift_m)} if any(self.shift_m) else {}
        change |= {"turn_deg": self.turn_deg} if self.turn_deg else {}
        return {"actors": {str(self.object_id): change}}

    def world_from_car(self, vehicle, time_s):
        """Moves the box: its centre, not the car's origin on the ground below, is what the edit turns about."""
        pose = vehicle.world_from_car(time_s)
        if vehicle.object_id != self.object_id:
            return pose
        car_from_box, box_motion = np.eye(4), np.eye(4)
        car_from_box[:3, 3] = np.mean(vehicle.bounds, 0)
        c, s = math.cos(math.radians(self.turn_deg)), math.sin(math.radians(self.turn_deg))
        box_motion[:2, :2] = [[c, -s], [s, c]]
        box_motion[:3, 3] = self.shift_m
        return pose @ car_from_box @ box_motion @ np.linalg.inv(car_from_box)

    def hides(self, vehicle):
        return self.remove and vehicle.object_id == self.object_id


NO_EDIT = Edit(0)
SHIFT_LEFT_M = 2.0
_AHEAD = TRAFFIC[1]
EDITS = {
    "removed": Edit(_AHEAD.object_id, remove=True),
    # Up with the camber of the road, so that the wheels stay on it.
    "shifted": Edit(
        _AHEAD.object_id,
        (0.0, SHIFT_LEFT_M, round(road.cross_z(_AHEAD.t + SHIFT_LEFT_M) - road.cross_z(_AHEAD.t), 6)),
    ),
    "turned": Edit(_AHEAD.object_id, turn_deg=20.0),
}
