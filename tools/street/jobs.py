# SPDX-License-Identifier: Apache-2.0
"""The list of images, most useful first in case a run is interrupted."""
from dataclasses import dataclass
from pathlib import Path

import cameras
import trajectory
from settings import (
    EDITED_INDICES,
    FIRST_ID,
    NOVEL_PLACES,
    NOVEL_VIEWS,
    ROLLING_READOUT_S,
    UNSEEN_VIEWS,
    frame_time_s,
)
from traffic import EDITS, NO_EDIT


@dataclass(frozen=True)
class Job:
    variant: str
    camera: str
    index: int  # frame
    novel: str = ""  # key of NOVEL_VIEWS
    edit: str = ""  # key of EDITS

    @property
    def frame_id(self):
        return FIRST_ID + self.index

    @property
    def name(self):
        return f"{self.camera}_{self.frame_id:07d}"

    @property
    def key(self):
        return "+".join(p for p in (self.variant, self.novel, self.edit, self.name) if p)

    @property
    def unedited(self):
        return Job("traffic", self.camera, self.index)

    @property
    def seed_text(self):
        """An edited image has the noise of the unedited one, so that they differ where the scene does."""
        return self.unedited.key if self.edit else self.key

    @property
    def has_traffic(self):
        return self.variant.startswith("traffic")

    @property
    def change(self):
        return EDITS.get(self.edit, NO_EDIT)

    @property
    def readout_s(self):
        return ROLLING_READOUT_S if self.variant == "rolling" else 0.0

    @property
    def exposure_s(self):
        """Returns seconds after the first frame; of a rolling shutter, of its middle row."""
        offset = 0.0 if self.novel else trajectory.TIME_OFFSET_S.get(self.camera, 0.0)
        return frame_time_s(self.index) + offset

    def world_from_body(self, time_s):
        return trajectory.shifted(trajectory.world_from_body(time_s), *NOVEL_VIEWS.get(self.novel, ((0, 0, 0), 0.0)))

    def image(self, settings):
        folder = settings.folder(self.variant)
        if self.novel:
            folder = folder / "novel" / self.novel
        else:
            folder = folder / self.edit if self.edit else folder / "sensor" / "camera" / self.camera
        return folder / f"{self.name}.jpg"

    def changed(self, settings):
        return self.image(settings).with_name(f"{self.name}_changed.png")

    def depth(self, settings):
        return self.image(settings).with_name(f"{self.name}_depth.png")

    def render(self, settings):
        return Path(settings.work) / "exr" / f"{self.key}.exr"


def novel_indices(settings):
    places = min(NOVEL_PLACES, settings.frames)
    return [(2 * k + 1) * settings.frames // (2 * places) for k in range(places)]


def cameras_of(variant):
    return list(cameras.rig(1)) if variant == "street" else list(cameras.FRONT_CAMERAS)


def all_jobs(settings):
    jobs = []
    if "street" in settings.variants:
        first, *others = cameras_of("street")
        jobs += [Job("street", first, i) for i in range(settings.frames)]
        seen = [n for n in settings.novel if n not in UNSEEN_VIEWS]
        jobs += [Job("street", cameras.NOVEL_CAMERA, i, n) for n in seen for i in novel_indices(settings)]
        jobs += [Job("street", c, i) for i in range(settings.frames) for c in others]
    for variant in ("traffic", "rolling"):
        if variant in settings.variants:
            jobs += [Job(variant, c, i) for i in range(settings.frames_of(variant)) for c in cameras_of(variant)]
    if "traffic_edited" in settings.variants:
        edited = [
            Job("traffic_edited", cameras.NOVEL_CAMERA, i, edit=e)
            for i in EDITED_INDICES
            if i < settings.frames_of("traffic_edited")
            for e in EDITS
        ]
        jobs += [j for j in dict.fromkeys(e.unedited for e in edited) if j not in jobs] + edited
    return jobs
