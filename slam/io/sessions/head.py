"""What a session says of itself, `session.json`: its format and version, its recordings, and where the robot stands."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ...errors import MapError
from ...estimation.slam_state import Anchor, TrackingCheckpoint
from ...geometry.segments import Floats
from ...localisation.tracker import PoseFix
from ...loop_closure.closer import LoopSearchState, PendingCandidate

FORMAT = "wclm-slam session"
VERSION = 3
KNOWN_VERSIONS = (1, 2, 3)
"""Version 1 does not know of walls that are no longer there, version 2 not of where the robot was adrift."""

Finite = Annotated[float, Field(allow_inf_nan=False)]
Pose = tuple[Finite, Finite, Finite]
Matrix = tuple[Pose, Pose, Pose]


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Recording(_Record):
    """A recording that is in a session: its `name`; the `path` that opens it again, if there is one; seconds that were
    added to its stamps, so that they follow the recording's before it; and of the stamps so shifted the first and last.
    """

    name: str
    path: str | None
    shift: Finite = 0.0
    first: Finite
    last: Finite


class _Place(_Record):
    pose: Pose
    odometry: Pose


class _Anchor(_Record):
    keyframe: int = Field(ge=0)
    relative: Pose
    covariance: Matrix
    odometry: Pose


class _Look(_Record):
    motion: Pose
    walls: list[int]
    travel: Finite


class _Looks(_Record):
    last_travel: Finite
    held: list[_Look]
    candidates: int
    refused: list[Pose]
    contested: Finite


class _Graph(_Record):
    updates: int = Field(ge=0)
    qr: bool


class _Learned(_Record):
    sigma_range: Finite
    odometry: list[list[Finite]]
    roughness: list[Finite]


class Head(_Record):
    """The whole of it."""

    format: str = FORMAT
    version: int = VERSION
    recordings: list[Recording]
    starts: list[int]
    firm: _Place | None
    step: Pose
    fit: Finite
    anchor: _Anchor | None
    kidnapped: bool
    kidnapped_keyframes: list[int]
    looks: _Looks
    graph: _Graph
    learned: _Learned

    @classmethod
    def of(
        cls,
        recordings: list[Recording],
        starts: list[int],
        checkpoint: TrackingCheckpoint,
        looks: LoopSearchState,
        graph: tuple[int, bool],
        learned: tuple[float, Floats, Floats],
    ) -> Head:
        """From what a session consists of; `graph` has its updates, and whether QR is used; `learned` the standard
        deviation of a range, motions as odometry claims them and as they were found (n, 6), and walls' unevenness."""
        held = [_data(look, walls=sorted(look.walls)) for look in looks.held]
        return cls.model_validate(
            {
                "recordings": recordings,
                "starts": starts,
                "firm": None if checkpoint.firm is None else _data(checkpoint.firm),
                "step": checkpoint.step.tolist(),
                "fit": checkpoint.fit,
                "anchor": None if checkpoint.anchor is None else _data(checkpoint.anchor),
                "kidnapped": checkpoint.kidnapped,
                "kidnapped_keyframes": list(checkpoint.kidnapped_keyframes),
                "looks": _data(looks, held=held, refused=[motion.tolist() for motion in looks.refused]),
                "graph": {"updates": graph[0], "qr": graph[1]},
                "learned": {
                    "sigma_range": learned[0],
                    "odometry": learned[1].tolist(),
                    "roughness": learned[2].tolist(),
                },
            }
        )

    @property
    def checkpoint(self) -> TrackingCheckpoint:
        """Where the robot stands."""
        firm, anchor = self.firm, self.anchor
        return TrackingCheckpoint(
            None if firm is None else PoseFix(np.array(firm.pose), np.array(firm.odometry)),
            np.array(self.step),
            self.fit,
            None
            if anchor is None
            else Anchor(
                anchor.keyframe, np.array(anchor.relative), np.array(anchor.covariance), np.array(anchor.odometry)
            ),
            self.kidnapped,
            self.kidnapped_keyframes,
        )

    @property
    def search_state(self) -> LoopSearchState:
        """What the search for loops remembers."""
        held = tuple(
            PendingCandidate(np.array(look.motion), frozenset(look.walls), look.travel) for look in self.looks.held
        )
        refused = tuple(np.array(motion) for motion in self.looks.refused)
        return LoopSearchState(self.looks.last_travel, held, self.looks.candidates, refused, self.looks.contested)


def _data(thing: Any, **instead: Any) -> dict[str, Any]:
    """The fields of a dataclass with slots, arrays as lists; some replaced."""
    fields = {name: instead.get(name, getattr(thing, name)) for name in thing.__slots__}
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in fields.items()}


def write_head(file: Path, head: Head) -> None:
    """Write it. Raises OSError."""
    file.write_text(json.dumps(head.model_dump(mode="json"), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def read_head(file: Path) -> Head:
    """Read it. Raises MapError naming the file and what is wrong: another version, for one."""
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise MapError(f"{file}: {error.strerror or error}") from error
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise MapError(f"{file}: is not JSON: {error}") from error
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise MapError(f'{file}: is not a session: its format is not "{FORMAT}"')
    if data.get("version") not in KNOWN_VERSIONS:
        known = ", ".join(str(version) for version in KNOWN_VERSIONS)
        raise MapError(f"{file}: is a session of version {data.get('version')}; this program reads version {known}")
    try:
        return Head.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise MapError(f"{file}: {place}: {first['msg']}") from error
