"""Find a lidar that is mounted upside down, whose scans are mirrored, by the turns of odometry."""

from __future__ import annotations

from .turn_scale import TurnScale, estimate_turn_scale
from .turns import MAX_SCAN_PERIOD, Turns

MIRRORED = -1.0
"""Scale of the turns of odometry if the scans are mirrored."""


class OdometryTurns:
    """What the turns of odometry, as multiples of those of the scans, say of the lidar's mount."""

    def __init__(self, turns: TurnScale) -> None:
        self._turns, self._used = turns, turns.decide([MIRRORED])

    def reason_to_mirror(self) -> str | None:
        """Return why scans must be mirrored, as the lidar is upside down, as a line of text; None if it is not."""
        if self._used != MIRRORED:
            return None
        return (
            f"scans of a lidar that is upside down, since odometry measures {self._turns}; mirrored (live: "
            "upside_down=1 of the device, or the transform of the lidar)"
        )

    def reason_to_ignore(self) -> str | None:
        """Return why odometry is of no use, as a line of text; None if it measures the turns of the robot."""
        if self._used is not None:
            return None
        return f"odometry does not measure the turns of the robot: it measures {self._turns}"

    def doubts(self, *, corrected: bool) -> list[str]:
        """Return what is probably wrong with odometry or the lidar's mount, as lines of text.

        corrected  if the scans are mirrored when they are read
        """
        if (reason := self.reason_to_ignore()) is not None:
            return [reason]
        if self._used == MIRRORED and not corrected:
            return [
                f"odometry measures {self._turns}: the lidar is upside down, which its mount does not state, or "
                "odometry turns the wrong way"
            ]
        return []


def compare_odometry_turns(turns: Turns) -> OdometryTurns | None:
    """Return the comparison over the turns of a drive; None if the data do not determine it."""
    if len(turns.odometry) < 2:
        return None
    stamps, headings = turns.odometry.T
    found = estimate_turn_scale(turns.runs, stamps, headings, MAX_SCAN_PERIOD)
    return None if found is None else OdometryTurns(found)
