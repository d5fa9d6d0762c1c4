# SPDX-License-Identifier: Apache-2.0
"""Options of one street, and constants that all its parts share."""
import json
import random
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

FIRST_ID = 1000  # frame ids are FIRST_ID, FIRST_ID + 1, ...
FRAME_RATE_HZ = 15.0
FIRST_TIME_S = 5000.0  # host clock of the first frame
SHORT_FRAMES = 24  # length of the traffic and rolling variants at most
NOVEL_PLACES = 6
ROLLING_READOUT_S = 0.030

EDITED_INDICES = (0, 6, 12, 18)  # frames of the edited traffic

# -> suffix of the recording's folder
VARIANTS = {"street": "", "traffic": "_traffic", "traffic_edited": "_traffic/edited", "rolling": "_rolling"}

# name -> (forward, left, up) in metres and yaw to the left in degrees, in body axes
NOVEL_VIEWS = {
    **{f"left_{d:g}": ((0.0, d, 0.0), 0.0) for d in (0.5, 1, 2, 3)},
    **{f"right_{d:g}": ((0.0, -d, 0.0), 0.0) for d in (0.5, 1, 2, 3)},
    "forward_0.5": ((0.5, 0.0, 0.0), 0.0),
    "up_0.3": ((0.0, 0.0, 0.3), 0.0),
    "up_1": ((0.0, 0.0, 1.0), 0.0),
    "yaw_15": ((0.0, 0.0, 0.0), 15.0),
}
SCANNED_VIEWS = ("left_1", "left_3", "right_1", "right_3", "up_1")  # seen by the LiDAR, too
UNSEEN_VIEWS = ("up_1",)  # not by a camera


@dataclass(frozen=True)
class Settings:
    out: str  # folder of the recording; the other variants get a suffix
    work: str  # scratch: scene, raw renders
    seed: int = 7
    size: float = 1.0  # factor on all image sizes
    frames: int = 48
    samples: int = 32  # light paths a rendered pixel
    variants: list = field(default_factory=lambda: list(VARIANTS))
    novel: list = field(default_factory=lambda: list(NOVEL_VIEWS))

    def save(self):
        """Writes the settings into the scratch folder, which must not hold renders of another street."""
        file = Path(self.work) / "settings.json"
        if file.exists():
            before = Settings.load(self.work)
            for name in ("seed", "size", "frames", "samples"):
                if getattr(before, name) != getattr(self, name):
                    raise SystemExit(
                        f"{file}: {name} {getattr(before, name)}: the folder holds renders of that; expected "
                        f"{getattr(self, name)}, or another --work"
                    )
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(asdict(self), indent=1))

    @staticmethod
    def load(work):
        return Settings(**json.loads((Path(work) / "settings.json").read_text()))

    def frames_of(self, variant):
        return self.frames if variant == "street" else min(self.frames, SHORT_FRAMES)

    def folder(self, variant):
        return Path(self.out + VARIANTS[variant])

    def rng(self, *part):
        """Returns a random.Random for each part, so that a change in one part leaves the others as they are."""
        return random.Random("/".join(map(str, (self.seed, *part))))

    def np_rng(self, *part):
        return np.random.default_rng(self.rng(*part).getrandbits(63))


def frame_time_s(index):
    """Seconds since the first frame."""
    return index / FRAME_RATE_HZ
