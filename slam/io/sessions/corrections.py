"""Manual corrections of a session: `session/corrections.json`, and the results before them.

`session/uncorrected/` is a complete output directory, with the session as it was before the first correction. The
corrections are applied to it in their order, so dropping the last one undoes it.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from ..json_files import read_json
from ..output_dir import SESSION
from .records import Finite, Record, validated

CORRECTIONS = "corrections.json"
UNCORRECTED = "uncorrected"
MAX_IDENTITY = 1 << 31
Identity = Annotated[int, Field(ge=0, lt=MAX_IDENTITY)]
Deviation = Annotated[Finite, Field(ge=1e-6)]


class Pin(Record):
    """Surveyed coordinates of a pose or of a point on a wall.

    id             stamp of the pose (seconds), or identity of the wall
    x, y           metres, in the frame of the survey
    xx, xy, yy     their covariance, square metres
    heading        of the robot, or of the line of the wall, radians; None if it was not surveyed
    sigma_heading  its standard deviation, radians
    """

    kind: Literal["pose", "wall"]
    id: Finite
    x: Finite
    y: Finite
    xx: Finite
    xy: Finite
    yy: Finite
    heading: Finite | None = None
    sigma_heading: Deviation | None = None

    @property
    def name(self) -> str:
        """Name for messages."""
        return f"wall {self.id:.0f}" if self.kind == "wall" else f"pose at {self.id:.12g} s"


class PinSet(Record):
    """Pins of one file, whose name is `file`."""

    kind: Literal["pins"] = "pins"
    file: str
    pins: list[Pin] = Field(min_length=1)

    @property
    def text(self) -> str:
        """What was corrected, in words."""
        return f"{len(self.pins)} pins of {self.file}"


class WallTie(Record):
    """Two walls are one, which has the identity of the first."""

    kind: Literal["tie"] = "tie"
    walls: tuple[Identity, Identity]

    @property
    def text(self) -> str:
        """What was corrected, in words."""
        return f"walls {self.walls[0]} and {self.walls[1]} are one"


class WallDeletion(Record):
    """A wall is none."""

    kind: Literal["deletion"] = "deletion"
    wall: Identity

    @property
    def text(self) -> str:
        """What was corrected, in words."""
        return f"wall {self.wall} is deleted"


class Place(Record):
    """Place of a drive: a keyframe, or the time at which the robot was there."""

    keyframe: Identity | None = None
    stamp: Finite | None = None

    @model_validator(mode="after")
    def _check(self) -> Place:
        if (self.keyframe is None) == (self.stamp is None):
            raise ValueError("must be a keyframe or a stamp")
        return self

    @property
    def text(self) -> str:
        """The place, in words."""
        return f"{self.stamp:.12g} s" if self.stamp is not None else f"keyframe {self.keyframe}"


class ProposedClosing(Record):
    """A loop that was proposed, and not closed, is closed."""

    kind: Literal["closing"] = "closing"
    loop: Identity

    @property
    def text(self) -> str:
        """What was corrected, in words."""
        return f"loop {self.loop} is closed"


class PlaceClosing(Record):
    """Two places are one."""

    kind: Literal["places"] = "places"
    places: tuple[Place, Place]

    @property
    def text(self) -> str:
        """What was corrected, in words."""
        return f"{self.places[0].text} and {self.places[1].text} are one place"


class LoopForbidding(Record):
    """A loop that was closed is not."""

    kind: Literal["forbidding"] = "forbidding"
    loop: Identity

    @property
    def text(self) -> str:
        """What was corrected, in words."""
        return f"loop {self.loop} is forbidden"


Correction = Annotated[
    PinSet | WallTie | WallDeletion | ProposedClosing | PlaceClosing | LoopForbidding, Field(discriminator="kind")
]


class _File(Record):
    corrections: list[Correction]


def write_corrections(directory: Path, corrections: list[Correction]) -> None:
    """Write the corrections of the session in the directory of a run. Raises OSError."""
    data = _File(corrections=corrections).model_dump(mode="json")
    text = json.dumps(data, indent=1, allow_nan=False)
    (directory / SESSION / CORRECTIONS).write_text(text + "\n", encoding="utf-8")


def read_corrections(directory: Path) -> list[Correction]:
    """Read the corrections of the session in the directory of a run, none if there is no such file. Raises MapError."""
    file = directory / SESSION / CORRECTIONS
    if not file.is_file():
        return []
    return validated(_File, read_json(file), file).corrections


def uncorrected(directory: Path) -> Path:
    """Return the directory of a run's results before its corrections: the directory itself if it has none."""
    before = directory / SESSION / UNCORRECTED
    return before if before.is_dir() else directory
