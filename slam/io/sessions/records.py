"""Building blocks of the records in a session: finite numbers, poses and matrices, and their validation."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ...errors import MapError, first_line
from ...geometry.segments import Floats
from .tables import MAX_MAGNITUDE

Finite = Annotated[float, Field(allow_inf_nan=False, ge=-MAX_MAGNITUDE, le=MAX_MAGNITUDE)]
Pose = tuple[Finite, Finite, Finite]
Matrix = tuple[Pose, Pose, Pose]


class Record(BaseModel):
    """Part of a JSON file of a session. Unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)


Kind = TypeVar("Kind", bound=Record)


def validated(kind: type[Kind], data: Any, file: Path) -> Kind:
    """Return the record in the content of a JSON file. Raises MapError naming the file and the first invalid value."""
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise MapError(f"{file}: {key}: {first_line(ValueError(first['msg']))}") from error


def to_pose(pose: Floats) -> Pose:
    """Return a pose (3,) as plain numbers."""
    x, y, heading = pose.tolist()
    return x, y, heading


def to_matrix(matrix: Floats) -> Matrix:
    """Return a matrix (3, 3) as plain numbers."""
    return to_pose(matrix[0]), to_pose(matrix[1]), to_pose(matrix[2])
