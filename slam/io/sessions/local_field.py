"""Records of the distance field around the robot in `session.json`; see `LocalFieldState`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from ...geometry.segments import Floats
from ...localisation.field_successor import FieldSuccessorState
from ...localisation.local_field import LocalFieldState
from .records import Length, Pose, Position, Record, to_pose


class _FieldSuccessor(Record):
    centre: Position
    keyframes: list[int]
    poses: list[Pose]

    @model_validator(mode="after")
    def _check(self) -> _FieldSuccessor:
        if len(self.poses) > len(set(self.keyframes)):
            raise ValueError("more keyframes were inserted than were to be inserted")
        return self


class LocalFieldRecord(Record):
    """State of the distance field around the robot."""

    centre: Position
    links: list[tuple[int, int]]
    gaps: list[tuple[int, Annotated[Length, Field(ge=0.0)]]]
    inserted: list[int]
    inserted_poses: list[Pose]
    successor: _FieldSuccessor | None = None

    @model_validator(mode="after")
    def _check(self) -> LocalFieldRecord:
        if not len(self.inserted_poses) == len(self.inserted) == len(set(self.inserted)):
            raise ValueError("does not have a pose for each keyframe that was inserted")
        return self

    @property
    def keyframes(self) -> list[int]:
        """All keyframes that the state refers to, some of them several times."""
        following = [] if self.successor is None else self.successor.keyframes
        linked = (keyframe for link in self.links for keyframe in link)
        return [*self.inserted, *following, *linked, *(keyframe for keyframe, _ in self.gaps)]


def local_field_record(state: LocalFieldState) -> LocalFieldRecord:
    """Return the record of a state."""
    following = state.successor
    return LocalFieldRecord.model_construct(
        centre=_to_position(state.centre),
        links=list(state.links),
        gaps=sorted(state.gaps.items()),
        inserted=list(state.inserted),
        inserted_poses=[to_pose(pose) for pose in state.inserted_poses],
        successor=None
        if following is None
        else _FieldSuccessor.model_construct(
            centre=_to_position(following.centre),
            keyframes=list(following.keyframes),
            poses=[to_pose(pose) for pose in following.poses],
        ),
    )


def local_field_state(record: LocalFieldRecord) -> LocalFieldState:
    """Return the state in a record."""
    following = record.successor
    return LocalFieldState(
        np.array(record.centre), record.links, dict(record.gaps), record.inserted, _from_poses(record.inserted_poses),
        None
        if following is None
        else FieldSuccessorState(np.array(following.centre), following.keyframes, _from_poses(following.poses)),
    )  # fmt: skip


def _to_position(position: Floats) -> tuple[float, float]:
    """Return a position (2,) as plain numbers."""
    return float(position[0]), float(position[1])


def _from_poses(poses: Sequence[Pose]) -> Floats:
    """Return saved poses as an array (k, 3)."""
    return np.array(poses, dtype=np.float64).reshape(-1, 3)
