"""Building blocks of the records in a session: finite numbers, poses and matrices, and their validation."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from drivers.validation import first_problem

from ...bounds import MAX_DEVIATION, MAX_LENGTH, MAX_MAGNITUDE
from ...errors import MapError
from ...geometry.segments import Floats
from .tables import are_covariances, are_semidefinite

Finite = Annotated[float, Field(allow_inf_nan=False, ge=-MAX_MAGNITUDE, le=MAX_MAGNITUDE)]
Length = Annotated[float, Field(allow_inf_nan=False, ge=-MAX_LENGTH, le=MAX_LENGTH)]
"""Metres or radians."""
Position = tuple[Length, Length]
Pose = tuple[Length, Length, Length]
Row = tuple[Finite, Finite, Finite]
Matrix = tuple[Row, Row, Row]


def _semidefinite(matrix: Matrix) -> Matrix:
    covariance = np.array([matrix])
    if not are_semidefinite(covariance) or not (covariance < MAX_DEVIATION**2).all():
        raise ValueError("is no covariance")
    return matrix


def _positive_definite(matrix: Matrix) -> Matrix:
    if not are_covariances(np.array([matrix])):
        raise ValueError("is no covariance")
    return matrix


Covariance = Annotated[Matrix, AfterValidator(_semidefinite)]
"""Of a pose; zero in directions in which it is certain."""
InvertibleCovariance = Annotated[Matrix, AfterValidator(_positive_definite)]


class Record(BaseModel):
    """Part of a JSON file of a session. Unknown keys are errors.

    Values are checked when a file is read. A record to be written is made with `model_construct`, which checks nothing:
    an unusual value must not cost the results of a drive.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)


Kind = TypeVar("Kind", bound=Record)


def validated(kind: type[Kind], data: Any, file: Path) -> Kind:
    """Return the record in the content of a JSON file. Raises MapError naming the file and the first invalid value."""
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        raise MapError(f"{file}: {first_problem(error)}") from error


def dumped(record: Record) -> dict[str, Any]:
    """Return the content of a JSON file that consists of a record, whatever its values are."""
    return record.model_dump(warnings=False)


def to_pose(pose: Floats) -> Pose:
    """Return a pose (3,) as plain numbers."""
    x, y, heading = pose.tolist()
    return x, y, heading


def to_matrix(matrix: Floats) -> Matrix:
    """Return a matrix (3, 3) as plain numbers."""
    return to_pose(matrix[0]), to_pose(matrix[1]), to_pose(matrix[2])
