"""The public benchmark recordings, where they are at hand, scored against the relations their surveyors checked."""

from __future__ import annotations

import time
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import KDTree

import drivers
from drivers import se2
from slam import Slam
from slam.config import Config, OdometryConfig, config_to_toml
from slam.evaluation.metrics import read_relations, score_reference, score_relations
from slam.events import Finished
from slam.io.exports import OccupancyGrid, Thresholds, place_scans, write_pgm, write_pgm_yaml
from slam.io.exports.occupancy import OCCUPIED
from slam.io.output_dir import CONFIG
from slam.io.plans.reader import read_plan
from slam.io.sessions import StoredSession, read_session, write_session
from slam.io.sessions.plan_session import plan_session
from slam.io.tum import Trajectory, read_tum
from slam.mapping.plan_map import build_plan_map
from slam.offline.optimisation import optimise

from ..recordings import recording_folder


@cache  # two tests compare with the same run, which takes up to a minute
def score(name: str, seconds: float | None = None, *, refine: bool = False) -> dict[str, float]:
    """The scores of the first `seconds` of a recording, or of all of it."""
    folder = recording_folder(name, "clf", "relations")
    slam, start = Slam(refine=refine), None
    for message in drivers.open(folder / f"{name}.clf"):
        start = message.stamp if start is None else start
        if seconds is not None and message.stamp - start > seconds:
            break
        slam.add(message)
    finished = slam.finish()
    relations = read_relations(folder / f"{name}.relations")
    return score_relations(Trajectory(finished.stamps, finished.poses), relations).figures()


def test_the_first_minutes_of_intel() -> None:
    figures = score("intel", 600.0)
    assert figures["relations"] > 500
    assert figures["trans_mean"] < 0.024
    assert figures["rot_mean"] < 0.6


@pytest.mark.slow
def test_intel() -> None:
    figures = score("intel")
    assert figures["missing"] == 0
    assert figures["trans_mean"] < 0.024
    assert figures["rot_mean"] < 0.9


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "translation", "rotation"), [("intel", 0.019, 0.65), ("fr079", 0.035, 0.55), ("csail", 0.030, 0.45)]
)
def test_the_second_look(name: str, translation: float, rotation: float) -> None:
    figures = score(name, refine=True)
    assert figures["missing"] == 0
    assert figures["trans_mean"] <= translation
    assert figures["rot_mean"] <= rotation


@pytest.mark.slow
@pytest.mark.parametrize(("name", "median"), [("intel-full", 0.013), ("fr079", 0.027), ("csail", 0.022)])
def test_without_odometry_as_accurate_as_with_it(name: str, median: float) -> None:
    """The medians are those with odometry; scans without their odometry may have an error 1.3 times as large."""
    slam = Slam(Config(odometry=OdometryConfig(source="none")))
    for message in drivers.open(recording_folder(name, "clf", "relations") / f"{name}.clf"):
        slam.add(message)
    figures = scored(name, slam.finish())
    assert figures["missing"] == 0
    assert figures["trans_median"] <= 1.3 * median
    assert figures["trans_max"] < 1.0


def scored(name: str, finished: Finished) -> dict[str, float]:
    relations = read_relations(recording_folder(name, "clf", "relations") / f"{name}.relations")
    return score_relations(Trajectory(finished.stamps, finished.poses), relations).figures()


def kept(slam: Slam, directory: Path) -> StoredSession:
    """What a run leaves, written down and read again."""
    directory.mkdir()
    (directory / CONFIG).write_text(config_to_toml(slam.config))
    write_session(directory, slam.session)
    return read_session(directory)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["intel", "fr079", "csail"])
def test_optimised_later_is_as_good_as_refined_at_once(name: str, tmp_path: Path) -> None:
    slam = Slam(keep_all_features=True)
    for message in drivers.open(recording_folder(name, "clf", "relations") / f"{name}.clf"):
        slam.add(message)
    slam.finish()
    started = time.process_time()
    figures = scored(name, optimise(kept(slam, tmp_path / "out")).finished)
    assert time.process_time() - started < 60.0
    assert figures["missing"] == 0
    assert figures["trans_mean"] <= score(name, refine=True)["trans_mean"] + 2e-4  # points are kept to the millimetre


@pytest.mark.slow
def test_intel_cut_in_two_and_gone_on_with(tmp_path: Path) -> None:
    messages = list(drivers.open(recording_folder("intel", "clf", "relations") / "intel.clf"))
    middle = 0.5 * (messages[0].stamp + messages[-1].stamp)
    first = Slam()
    for message in messages:
        if message.stamp < middle:
            first.add(message)
    first.finish()
    second = Slam(resumed=kept(first, tmp_path / "out"))
    for message in messages:
        if message.stamp >= middle:
            second.add(message)
    figures = scored("intel", second.finish())
    assert figures["missing"] == 0
    assert figures["trans_mean"] <= 1.1 * score("intel")["trans_mean"]


@pytest.mark.slow
def test_the_picture_for_ros_agrees_with_one_of_gmappings_path(wclm: Any, map_server: Any) -> None:
    """Both in the frame of the picture. GMapping's path is off by some 0.1 m itself, so not all walls can agree."""
    folder = recording_folder("intel", "clf", "gmapping.tum")
    assert wclm("run", folder / "intel.clf", "--out", "out", "--no-review").exit_code == 0
    assert wclm("map", "out", "--format", "pgm").exit_code == 0
    ours = map_server(Path("out/map.yaml")).occupied()
    path = read_tum(folder / "intel.gmapping.tum")
    carried = se2.inverse(score_reference(read_tum(Path("out/trajectory.tum")), path).alignment)
    grid = OccupancyGrid(0.05)
    in_our_frame = Trajectory(path.stamps, se2.compose(carried, path.poses))
    grid.add_all(place_scans(drivers.open(folder / "intel.clf"), in_our_frame, Config()))
    theirs = grid.occupancy().centres(OCCUPIED)
    assert min(len(ours), len(theirs)) > 10_000
    for some, others in ((ours, theirs), (theirs, ours)):
        distance = KDTree(others).query(some)[0]
        assert np.mean(distance < 0.10 + 1e-9) >= 0.90  # two cells away is 0.10 m, give or take the last bit


@pytest.mark.slow
def test_the_second_half_of_csail_is_localised_on_a_grid_map(tmp_path: Path) -> None:
    """The grid map is that of the whole drive; the start is unknown."""
    source = drivers.open(recording_folder("csail", "clf") / "csail.clf")
    messages = list(source)
    mapping = Slam()
    for message in messages:
        mapping.add(message)
    finished = mapping.finish()
    path = Trajectory(finished.stamps, finished.poses)
    grid = OccupancyGrid(0.05)
    grid.add_all(place_scans(messages, path, Config()))
    write_pgm(tmp_path / "csail.pgm", grid.occupancy(Thresholds()))
    write_pgm_yaml(tmp_path / "csail.yaml", grid.occupancy(Thresholds()), "csail.pgm")
    plan = build_plan_map(read_plan(tmp_path / "csail.yaml"), (0.03, np.radians(0.3)))
    localising = Slam(resumed=plan_session(plan, Config()), frozen=True)
    for message in messages[len(messages) // 2 :]:
        localising.add(message)
    found = localising.finish()
    error = np.hypot(*(found.poses - path.at(found.stamps).poses)[:, :2].T)
    assert np.median(error) < 0.02
    assert np.quantile(error, 0.95) < 0.05
