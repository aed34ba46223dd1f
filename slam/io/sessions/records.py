"""Building blocks of the records in `session.json`: finite numbers, poses and matrices."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from ...geometry.segments import Floats
from .tables import MAX_MAGNITUDE

Finite = Annotated[float, Field(allow_inf_nan=False, ge=-MAX_MAGNITUDE, le=MAX_MAGNITUDE)]
Pose = tuple[Finite, Finite, Finite]
Matrix = tuple[Pose, Pose, Pose]


class Record(BaseModel):
    """Part of `session.json`. Unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def to_pose(pose: Floats) -> Pose:
    """Return a pose (3,) as plain numbers."""
    x, y, heading = pose.tolist()
    return x, y, heading


def to_matrix(matrix: Floats) -> Matrix:
    """Return a matrix (3, 3) as plain numbers."""
    return to_pose(matrix[0]), to_pose(matrix[1]), to_pose(matrix[2])
