"""Parts of interlaced scans that arrive long after their measurement get the times at which they were measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import drivers
from drivers.messages import Message, Odometry, Scan
from drivers.recordings.mcap import McapWriter
from drivers.timing.interlacing import find_interlacing
from drivers.timing.turns import Turns

from .drives import office_drive

LATE = 0.09
"""Seconds, half the time from turn to turn of the lidar."""


def interlaced(*late: float) -> list[Message]:
    """Return a drive in which each scan is divided into parts, each stamped `late` by some seconds."""
    drive: list[Message] = []
    for message in office_drive():
        if isinstance(message, Scan):
            for k, seconds in enumerate(late):
                names = "ranges", "angles", "time_offsets"
                values = {name: getattr(message, name)[k :: len(late)] for name in names}
                drive.append(replace(message, stamp=message.stamp + seconds, **values))
        else:
            drive.append(message)
    return sorted(drive, key=lambda message: message.stamp)


def scans_of(drive: Sequence[Message]) -> list[Scan]:
    return [message for message in drive if isinstance(message, Scan)]


@pytest.mark.parametrize("late", [(0.0, LATE), (LATE, 0.0)], ids=["second", "first"])
def test_the_late_part_is_found_from_the_scans_alone(late: tuple[float, float]) -> None:
    found = find_interlacing(Turns(scans_of(interlaced(*late))))
    assert found is not None
    assert found.sigma < 0.01
    np.testing.assert_allclose(found.lateness, late, atol=4.0 * found.sigma)


@pytest.mark.parametrize("late", [(0.0,), (0.0, 0.001)], ids=["no parts", "no part late"])
def test_scans_that_are_stamped_alike_are_left_as_they_are(late: tuple[float, ...]) -> None:
    assert find_interlacing(Turns(interlaced(*late))) is None


def test_a_recording_is_read_with_the_times_of_measurement(tmp_path: Path) -> None:
    with McapWriter(tmp_path / "drive.mcap") as writer:
        for message in interlaced(0.0, LATE):
            writer.write(message)
    source = drivers.open(str(tmp_path / "drive.mcap"))
    read = list(source)
    stamps = [message.stamp for message in read]
    assert stamps == sorted(stamps)
    assert sum(isinstance(m, Odometry) for m in read) == sum(isinstance(m, Odometry) for m in office_drive())
    first, second = (np.sort([s.stamp for s in scans_of(read) if (s.angles[0] > -3.14) == k]) for k in (False, True))
    np.testing.assert_allclose(first, second, atol=0.02)
    assert [line for line in source.report.interpretations if "interlaced scans: those from" in line]
