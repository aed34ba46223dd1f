"""Suspects of a run: from the pipeline to the terminal."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers import se2
from drivers.elapsed import elapsed
from drivers.messages import GroundTruth, Message, Odometry, Scan
from drivers.simulation import LIDAR_MODELS, WHEEL_MODELS, Simulation
from slam import Slam
from slam.checks import adapter
from slam.checks.suspect import UNCONSTRAINED
from slam.cli.run_summary import SHOWN_SUSPECTS, RunResult, format_summary
from slam.evaluation.benchmarks.scenarios.buildings import random_building, wide_hall
from slam.evaluation.benchmarks.scenarios.log_variants import thin
from slam.events import EventRecorder, Finished, SuspectFound
from slam.offline.optimisation import optimise

from .drives import LIDAR

DURATION, FIRST, LAST = 40.0, 15.0, 28.0
START = 1e9
"""Stamp of the start, as of a clock that counts from 1970."""


def messages(*, carried: bool) -> list[Message]:
    """Return a drive; if `carried`, the robot is carried between two times, unnoticed by odometry."""
    found = [m for m in Simulation("office", duration=DURATION, lidar=LIDAR) if not isinstance(m, GroundTruth)]
    if not carried:
        return found
    odometry = [message for message in found if isinstance(message, Odometry)]
    before = [message.pose for message in odometry if message.stamp < FIRST][-1]
    after = next(message.pose for message in odometry if message.stamp >= LAST)
    kept: list[Message] = [message for message in found if message.stamp < FIRST]
    for message in found:
        if message.stamp >= LAST:
            message = replace(message, stamp=message.stamp - (LAST - FIRST))
            if isinstance(message, Odometry):
                message = replace(message, pose=se2.compose(before, se2.between(after, message.pose)))
            kept.append(message)
    return kept


def run(drive: list[Message]) -> tuple[Finished, EventRecorder]:
    listener = EventRecorder()
    slam = Slam(sinks=[listener])
    for message in drive:
        slam.add(message)
    return slam.finish(), listener


def test_a_clean_run_is_silent() -> None:
    finished, listener = run(messages(carried=False))
    assert finished.summary["suspects"] == []
    assert not listener.of(SuspectFound)


@pytest.mark.slow
def test_a_hall_wider_than_the_range_is_reported() -> None:
    """Behind its empty middle, 10 m, the map is placed by odometry only, also after a refinement offline."""
    slam = Slam(keep_all_features=True)
    for message in Simulation(wide_hall(), 3, 36.0, LIDAR_MODELS["short"], WHEEL_MODELS["bad"]):
        slam.add(message)
    for finished in (slam.finish(), optimise(slam.session).finished):
        rows: Any = finished.summary["suspects"]
        (row,) = [row for row in rows if row["check"] == UNCONSTRAINED]
        assert 20.0 < row["first"] < 24.0 < 30.0 < row["last"] < 35.0
        assert "placed by odometry only" in row["sentence"]


@pytest.mark.slow
def test_a_turn_in_a_hall_wider_than_the_range_is_reported() -> None:
    """The end of the turn is certain to 14 cm, but the heading only to 7 degrees: 12 m farther that is 1.5 m."""
    slam, lidar = Slam(), replace(LIDAR_MODELS["short"], rate=4.0, range_max=6.0)
    for message in Simulation("square", 2, 40.0, lidar, WHEEL_MODELS["bad"]):
        slam.add(message)
    rows: Any = slam.finish().summary["suspects"]
    (row,) = [row for row in rows if row["check"] == UNCONSTRAINED]
    assert 19.0 < row["first"] < 22.0 < row["last"] < 24.0


@pytest.mark.slow
def test_a_hole_in_the_scans_is_reported() -> None:
    """The lidar is unplugged for 20 s while the robot drives into another room."""
    slam, first, last = Slam(), 40.0, 60.0
    for message in Simulation(random_building(457), 457, 70.0, LIDAR, WHEEL_MODELS["good"]):
        if not (isinstance(message, Scan) and first <= message.stamp < last):
            slam.add(message)
    rows: Any = slam.finish().summary["suspects"]
    (row,) = [row for row in rows if row["check"] == UNCONSTRAINED]
    assert first - 1.0 < row["first"] < first < last < row["last"] < last + 1.0
    assert "there are no scans" in row["sentence"]


def test_scans_a_metre_apart_leave_no_hole(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in many published logs: each scan shows what the one before it showed."""
    # as in a corridor of hundreds of metres, whose far end is uncertain by the heading of each step
    monkeypatch.setattr(adapter, "_displacement_by_turn", lambda *_: 2.0 * adapter.MAX_BLIND_SIGMA)
    slam, simulation = Slam(), Simulation("large_loop", seed=0, duration=100.0, lidar=LIDAR)
    for message in thin(1.1, np.pi)(simulation, np.random.default_rng(0)):
        slam.add(message)
    finished = slam.finish()
    assert np.median(np.diff(slam.slam_state.mapper.travelled)) > adapter.MIN_BLIND_LENGTH
    assert UNCONSTRAINED not in [row["check"] for row in finished.summary["suspects"]]


def test_a_carried_robot_is_reported() -> None:
    drive = [replace(message, stamp=START + message.stamp) for message in messages(carried=True)]
    finished, listener = run(drive)
    rows: Any = finished.summary["suspects"]
    events = listener.of(SuspectFound)
    assert [row["sentence"] for row in rows] == [event.text for event in events]
    for row in rows:
        assert row["sentence"].startswith(f"at {elapsed(row['stamp'] - finished.stamps[0])}: {row['text']}")
    assert any(abs(row["stamp"] - START - FIRST) < 3.0 for row in rows)
    assert isinstance(listener.events[-1], Finished)
    for event in events:
        assert finished.keyframes.stamps[event.index] <= event.stamp
        assert np.isfinite(event.position).all()


def summary_with(**slam: Any) -> dict[str, Any]:
    """Return a summary of a run, with some entries under `slam`."""
    return {
        "recording": "a.clf", "scans": 9, "start": 0.0, "duration": 9.0, "path_length": 9.0, "walls": 4, "corners": 4,
        "keyframes": 3, "slam_seconds": 1.0, "wall_seconds": 1.0, "real_time_factor": 9.0, "peak_memory_mib": 9.0,
        "truth": None, "skipped": {"messages": 0}, "warnings": [], "slam": slam,
    }  # fmt: skip


def lines(tmp_path: Path, count: int) -> list[str]:
    """Return the lines of the terminal that name suspects."""
    summary = summary_with(suspects=[{"sentence": f"at 0:0{k}: the map"} for k in range(count)])
    return [line for line in format_summary(RunResult(summary, False), tmp_path) if "suspect" in line.lower()]


def test_the_terminal_names_what_the_report_page_calls_grave(tmp_path: Path) -> None:
    """A map that few scans agree with looks like any other in the terminal."""
    text = "\n".join(format_summary(RunResult(summary_with(health={"overlap_ratio_median": 0.71}), False), tmp_path))
    assert "  warning    only 71 % of the walls that a scan shows are on walls of the map: the path is wrong, " in text
    text = "\n".join(format_summary(RunResult(summary_with(health={"overlap_ratio_median": 0.97}), False), tmp_path))
    assert "warning" not in text


def test_the_terminal_shows_the_worst_suspects(tmp_path: Path) -> None:
    assert lines(tmp_path, 0) == []
    assert lines(tmp_path, 2) == ["  SUSPECT at 0:00: the map", "  SUSPECT at 0:01: the map"]
    many = lines(tmp_path, SHOWN_SUSPECTS + 3)
    assert len(many) == SHOWN_SUSPECTS + 1
    assert many[-1] == "  and 3 more suspects in summary.json"


def test_parts_of_a_map_that_a_run_only_localises_in_are_not_those_of_the_run(tmp_path: Path) -> None:
    parts = [{"stamp": stamp, "keyframe": 0, "joined": True} for stamp in (-90.0, -45.0)]
    text = "\n".join(format_summary(RunResult(summary_with(parts=parts), False), tmp_path))
    assert "in the map; those from" not in text
    text = "\n".join(
        format_summary(RunResult(summary_with(parts=[*parts, parts[0] | {"stamp": 5.0}]), False), tmp_path)
    )
    assert "parts      3 in the map; those from 0:05 joined" in text
