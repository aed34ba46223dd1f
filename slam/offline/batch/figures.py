"""Figures of a run that the table of a batch contains, read from `summary.json`."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, Field, ValidationError

Count = Annotated[int, Field(ge=0, lt=1 << 53)]


class _Loops(BaseModel):
    accepted: Count = 0
    retracted: Count = 0


class _Slam(BaseModel):
    loops: _Loops | None = None


class _Truth(BaseModel):
    ate_rmse: float | None = None


class Figures(BaseModel):
    """Figures in the content of a `summary.json`; None if unknown.

    duration         seconds of the recording
    path_length      travelled distance, metres
    wall_seconds     computing time
    peak_memory_mib  largest memory of the process, MiB
    """

    duration: float | None = None
    path_length: float | None = None
    scans: Count | None = None
    keyframes: Count | None = None
    wall_seconds: float | None = None
    peak_memory_mib: float | None = None
    slam: _Slam | None = None
    truth: _Truth | None = None

    @property
    def closures(self) -> int | None:
        """Loop closures that were accepted and not retracted."""
        loops = None if self.slam is None else self.slam.loops
        return None if loops is None else loops.accepted - loops.retracted

    @property
    def error_rmse(self) -> float | None:
        """Root mean square error of the positions, metres, if the recording has ground truth."""
        return None if self.truth is None else self.truth.ate_rmse


def has_figures(summary: dict[str, Any]) -> bool:
    """Return False if a figure of a summary has another type, as in a damaged file."""
    try:
        Figures.model_validate(summary)
    except ValidationError:
        return False
    return True
