"""Watch what is in the view of a lidar of which nothing is known beforehand, as in a live run: the floor, the robot,
or what another lidar sees.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from ..messages import Message, SourceReport
from .alternating_sources import AlternatingSources
from .floor import FloorDetector
from .own_returns import OwnReturnsDetector


def watched(messages: Iterable[Message], report: SourceReport, limits: tuple[float, float]) -> Iterator[Message]:
    """Yield messages of a source that cannot look ahead, and report as doubts that the floor or the robot is in view,
    or that the scans are of two sources.

    limits  metres between which ranges are used; what is nearer or farther away does no harm
    """
    floors, own, sources = FloorDetector(), OwnReturnsDetector(), AlternatingSources()
    for message in messages:
        floors.add(message)
        own.add(message)
        sources.add(message)
        yield message
    if (text := sources.describe()) is not None:
        report.doubts.append(text)
    floor, robot = floors.found(), own.found()
    if floor is not None and floor.distance < limits[1]:
        report.doubts.append(f"{floor}; mount it level, or set lidar.range_max={floor.safe_range:.1f}")
    if robot is not None and robot.farthest > limits[0]:
        report.doubts.append(f"{robot}; set lidar.range_min={robot.safe_range:.1f}")
