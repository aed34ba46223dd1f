from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from drivers import se2
from features.types import Corners, Features, Lines, Noise
from slam.cli.commands.demo_recorders import ClosureRecorder
from slam.errors import MapError, OutputError
from slam.evaluation.metrics import Relations, score_reference, score_relations
from slam.events import Correction, Finished, LoopDecided, MapUpdated
from slam.io.run_results import RunResults
from slam.io.tum import Trajectory
from slam.loop_closure.loop_status import LoopStatus
from slam.visualisation.plots import plot_map, plot_reference, plot_relations, plot_scan
from slam.visualisation.plots.correction import plot_correction


def size(path: Path) -> tuple[int, int]:
    """Width and height of a PNG, from its header."""
    header = path.read_bytes()[:24]
    assert header[:8] == b"\x89PNG\r\n\x1a\n"
    return int.from_bytes(header[16:20]), int.from_bytes(header[20:24])


def scan() -> tuple[np.ndarray, np.ndarray, Features]:
    angles = np.linspace(-np.pi / 2, np.pi / 2, 181)
    ranges = np.minimum(3.0 / np.maximum(np.cos(angles), 1e-9), 4.0)
    ranges[::20] = np.nan
    lines = Lines(
        uv=np.array([[1 / 3, 0.0]]),
        covariance=1e-6 * np.eye(2)[None],
        start=np.array([[3.0, -2.6]]),
        end=np.array([[3.0, 2.6]]),
        first=np.array([49]),
        last=np.array([131]),
        count=np.array([80]),
        chi2=np.array([78.0]),
        curved=np.array([False]),
    )
    corners = Corners(np.array([[3.0, 2.6]]), 1e-4 * np.eye(2)[None], np.array([[0, 0]]))
    return ranges, angles, Features(lines, corners, Noise(0.01, 0.001))


def without_features(features: Features) -> Features:
    lines = Lines(**{f.name: getattr(features.lines, f.name)[:0] for f in fields(Lines)})
    corners = Corners(**{f.name: getattr(features.corners, f.name)[:0] for f in fields(Corners)})
    return Features(lines, corners, features.noise)


def test_a_scan_is_drawn_with_and_without_features(tmp_path: Path) -> None:
    ranges, angles, features = scan()
    plot_scan(tmp_path / "a.png", ranges, angles, features, title="a scan")
    plot_scan(tmp_path / "b.png", ranges, angles, without_features(features), title="nothing found")
    plot_scan(tmp_path / "c.png", np.full(181, np.nan), angles, without_features(features), title="nothing seen")
    for name in "abc":
        assert min(size(tmp_path / f"{name}.png")) > 500


def test_a_map_is_drawn_true_to_scale_with_all_there_is_to_show(tmp_path: Path, finished: Finished) -> None:
    odometry = se2.compose([0, 0, 0.1], finished.poses)
    plot_map(
        tmp_path / "a.png",
        finished.walls,
        finished.corners,
        [Trajectory(finished.stamps, finished.poses)],
        title="a room",
        odometry=odometry,
        truth=finished.poses + np.array([0.01, 0.0, 0.0]),
    )
    width, height = size(tmp_path / "a.png")
    assert 1.0 < width / height < 1.5  # the room is 6 m by 4 m


def test_a_map_without_walls_and_corners_is_drawn(tmp_path: Path, finished: Finished) -> None:
    lines = replace(finished.walls, **{f.name: getattr(finished.walls, f.name)[:0] for f in fields(finished.walls)})
    corners = {f.name: getattr(finished.corners, f.name)[:0] for f in fields(finished.corners)}
    start = Trajectory(finished.stamps[:1], finished.poses[:1])
    plot_map(tmp_path / "a.png", lines, replace(finished.corners, **corners), [start], title="nothing")
    assert min(size(tmp_path / "a.png")) > 500


@pytest.mark.slow
def test_a_narrow_map_with_a_long_title_is_drawn(tmp_path: Path, finished: Finished) -> None:
    """Names of bags are long; without room for the title, a warning was printed and nothing was laid out."""
    lines = replace(finished.walls, **{f.name: getattr(finished.walls, f.name)[:0] for f in fields(finished.walls)})
    corners = {f.name: getattr(finished.corners, f.name)[:0] for f in fields(finished.corners)}
    along = Trajectory(np.array([0.0, 1.0]), np.array([[0.0, 0.0, 0.0], [0.0, 30.0, 0.0]]))
    title = "robobehaviors_fsm_bags_wall_follow_with_marker_wall_follow_with_marker_0.db3"
    plot_map(tmp_path / "a.png", lines, replace(finished.corners, **corners), [along], title=title)
    width, height = size(tmp_path / "a.png")
    assert width > 1200
    assert height > 1500


@pytest.mark.slow
def test_errors_are_drawn(tmp_path: Path, finished: Finished) -> None:
    truth = Trajectory(finished.stamps, finished.poses)
    estimate = Trajectory(finished.stamps, finished.poses + np.random.default_rng(1).normal(0, 0.01, (101, 3)))
    relations = Relations(truth.stamps[:-10], truth.stamps[10:], se2.between(truth.poses[:-10], truth.poses[10:]))
    plot_relations(tmp_path / "a.png", score_relations(estimate, relations), title="relations")
    plot_reference(tmp_path / "b.png", score_reference(estimate, truth), title="reference")
    for name in "ab":
        assert min(size(tmp_path / f"{name}.png")) > 500


def test_a_picture_that_cannot_be_written_is_an_output_error(tmp_path: Path) -> None:
    ranges, angles, features = scan()
    with pytest.raises(OutputError, match=r"a\.png: cannot be written: No such file"):
        plot_scan(tmp_path / "nowhere" / "a.png", ranges, angles, features, title="a scan")


def closure(finished: Finished, shift: float) -> list[LoopDecided | MapUpdated]:
    """Return the events of a closure at the last keyframe."""
    before = finished.keyframes.poses + np.linspace(0.0, shift, len(finished.keyframes))[:, None] * [1.0, 0.0, 0.0]
    last = len(before) - 1
    correction = Correction(before, finished.keyframes.poses, finished.walls, 1.0, 9.0, 2.0)
    decided = LoopDecided(
        last, 1.0, 1, 0, np.zeros(3), LoopStatus.ACCEPTED, "", 0.9, 4, 0.0, 0.01, 0.0, (), shift, correction=correction
    )
    after = MapUpdated(last, 1.0, finished.keyframes.poses, finished.walls, finished.corners, 2.0, shift)
    return [decided, after]


def test_the_closure_that_moved_the_robot_most_is_drawn(tmp_path: Path, finished: Finished) -> None:
    recorder = ClosureRecorder()
    with pytest.raises(MapError, match="no loop was closed"):
        recorder.plot(tmp_path / "none.png")
    for event in [*closure(finished, 0.4), *closure(finished, 1.5), *closure(finished, 0.8)]:
        recorder.handle(event)
    assert recorder.decided is not None
    assert recorder.decided.shift == 1.5
    recorder.plot(tmp_path / "closure.png")
    assert min(size(tmp_path / "closure.png")) > 500


def test_a_map_is_drawn_before_and_after_a_correction(tmp_path: Path, finished: Finished) -> None:
    trajectory = Trajectory(finished.stamps, finished.poses)
    results = RunResults(tmp_path, finished.walls, finished.corners, trajectory, {}, finished.keyframes)
    plot_correction(tmp_path / "a.png", results, results, (0, 1), ("before", "after"), title="a correction")
    width, height = size(tmp_path / "a.png")
    assert width > 1.5 * height > 500
    with pytest.raises(ValueError, match="no keyframes"):
        plot_correction(tmp_path / "b.png", results, replace(results, keyframes=None), (0, 1), ("", ""), title="")
    assert not (tmp_path / "b.png").exists()
