"""A recording is mapped with one call, as `wclm run` maps it, and the result displays itself."""

from __future__ import annotations

import json
import re
from base64 import b64decode
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import gtsam
import numpy as np
import pytest
from PIL import Image

import drivers
import slam
from drivers import se2
from drivers.messages import Scan
from drivers.recordings.mcap import McapWriter
from drivers.simulation import LIDAR_MODELS, Simulation
from slam.config import LidarConfig
from slam.errors import ArgumentError, OutputError, SlamError
from slam.io.exports import write_pgm
from slam.io.recording_timing import UNKNOWN_MOUNT
from slam.io.run_results import read_run_results
from slam.io.tum import read_tum_poses

ROOM = "sim:room?duration=10&seed=2&lidar=short"


@pytest.fixture(scope="module")
def mapped() -> slam.MappedRecording:
    return slam.run(ROOM)


def test_map_and_path_are_those_of_wclm_run(wclm: Any, mapped: slam.MappedRecording, tmp_path: Path) -> None:
    assert wclm("run", ROOM, "--out", "map", "--no-review").exit_code == 0
    stamps, poses = read_tum_poses(tmp_path / "map" / "trajectory.tum")
    np.testing.assert_allclose(mapped.stamps, stamps, atol=1e-6)
    np.testing.assert_allclose(mapped.path, poses, atol=1e-6)  # rounded in the file


def test_the_true_path_is_in_the_map_and_odometry_begins_with_the_path(mapped: slam.MappedRecording) -> None:
    assert mapped.truth is not None
    difference = se2.between(mapped.truth.at(mapped.stamps).poses, mapped.path)
    assert np.hypot(difference[:, 0], difference[:, 1]).max() < 0.02
    np.testing.assert_allclose(mapped.odometry[0], mapped.path[0], atol=1e-9)


def test_a_late_lidar_is_as_accurate_as_one_in_time(wclm: Any, tmp_path: Path) -> None:
    """The true path has the clock of odometry, and the path that of the lidar."""
    drive = list(Simulation("room", seed=2, duration=10.0, lidar=LIDAR_MODELS["short"]))
    for name, late in (("late", 0.25), ("in_time", 0.0)):
        messages = (replace(m, stamp=m.stamp + late) if isinstance(m, Scan) else m for m in drive)
        with McapWriter(tmp_path / f"{name}.mcap") as writer:
            for message in sorted(messages, key=lambda message: message.stamp):
                writer.write(message)
        settings = ("--set", f"lidar.delay={late}")
        assert wclm("run", f"{name}.mcap", "--out", name, "--no-review", *settings).exit_code == 0
    errors = [
        json.loads((tmp_path / name / "summary.json").read_text())["truth"]["ate_rmse"] for name in ("late", "in_time")
    ]
    assert errors[0] == pytest.approx(errors[1], abs=5e-4)
    late_config = slam.Config(lidar=LidarConfig(delay=0.25))
    mapped = slam.run(tmp_path / "late.mcap", late_config)
    assert mapped.truth is not None
    difference = se2.between(mapped.truth.at(mapped.stamps).poses, mapped.path)
    assert np.hypot(difference[:, 0], difference[:, 1]).max() < 0.02


def test_it_displays_itself_in_a_notebook(mapped: slam.MappedRecording) -> None:
    assert repr(mapped).startswith(f"<sim:room: {len(mapped.walls)} walls, {len(mapped.corners)} corners")
    assert ElementTree.fromstring(mapped._repr_svg_()).tag.endswith("svg")
    html = mapped._repr_html_()
    assert f"<td>{len(mapped.walls)} walls, {len(mapped.corners)} corners</td>" in html
    (picture,) = re.findall(r"base64,([^\"]+)", html)
    assert b64decode(picture).decode() == mapped.svg()


def test_parts_of_a_result_are_one_short_line_in_a_terminal(mapped: slam.MappedRecording, tmp_path: Path) -> None:
    mapped.save(tmp_path / "a")
    parts = mapped, mapped.finished, mapped.walls, mapped.corners, mapped.keyframes, mapped.trajectory
    for part in (*parts, mapped.wall_map(), read_run_results(tmp_path / "a")):
        assert re.fullmatch(r"<[^\n]{,200}>", repr(part))


def test_it_measures_rooms_and_draws_dimension_lines(mapped: slam.MappedRecording) -> None:
    measurements = mapped.measurements()
    assert max(one.value for one in measurements if one.kind == "area") == mapped.rooms()[0].area
    assert 'class="dimensions"' in mapped.svg(measurements)


def test_it_has_an_occupancy_grid_and_the_covariances_of_the_keyframes(
    wclm: Any, mapped: slam.MappedRecording, tmp_path: Path
) -> None:
    assert wclm("run", ROOM, "--out", "map", "--no-review").exit_code == 0
    assert wclm("map", "map", "--format", "pgm").exit_code == 0
    occupancy = mapped.occupancy()
    write_pgm(tmp_path / "map.pgm", occupancy)
    with Image.open(tmp_path / "map" / "map.pgm") as exported, Image.open(tmp_path / "map.pgm") as written:
        assert written.size == exported.size == occupancy.cells.shape[::-1]
        assert np.mean(np.asarray(written) != np.asarray(exported)) < 0.01  # trajectories in files are rounded
    keyframes = mapped.keyframes
    assert keyframes.covariance.shape == (len(keyframes), 3, 3)
    assert np.linalg.eigvalsh(keyframes.covariance[1:]).min() > 0.0


def test_it_plots_into_a_file(mapped: slam.MappedRecording, tmp_path: Path) -> None:
    mapped.plot(tmp_path / "map.png")
    with Image.open(tmp_path / "map.png") as picture:
        assert min(picture.size) > 300
    with pytest.raises(OutputError, match=r"map\.svg: the name must end with \.png"):
        mapped.plot(tmp_path / "map.svg")


def test_a_robot_that_stands_has_driven_nothing(mapped: slam.MappedRecording) -> None:
    """Its estimated position jitters."""
    jitter = np.random.default_rng(0).normal(0.0, 0.002, mapped.path.shape)
    standing = replace(mapped, finished=replace(mapped.finished, poses=jitter))
    assert repr(standing).endswith(" 0.0 m driven>")
    assert "<td>0.0 m in" in standing._repr_html_()


def test_own_factors_can_be_added_to_a_copy_of_the_graph(mapped: slam.MappedRecording) -> None:
    graph, values = mapped.factor_graph()
    key = gtsam.symbol("x", len(mapped.finished.keyframes) - 1)
    pose = values.atPose2(key)
    np.testing.assert_allclose([pose.x(), pose.y()], mapped.finished.keyframes.poses[-1, :2], atol=1e-6)
    count = graph.size()
    graph.add(gtsam.PriorFactorPose2(key, gtsam.Pose2(9.0, 9.0, 0.0), gtsam.noiseModel.Isotropic.Sigma(3, 1e-4)))
    moved = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize().atPose2(key)
    assert np.hypot(moved.x() - 9.0, moved.y() - 9.0) < 1.0
    again, unmoved = mapped.factor_graph()
    assert again.size() == count
    assert unmoved.atPose2(key).x() == pose.x()


def test_a_recording_without_odometry_is_mapped_without_it(tmp_path: Path) -> None:
    with McapWriter(tmp_path / "scans.mcap") as writer:
        for message in Simulation("room", seed=1, duration=4.0):
            if isinstance(message, Scan):
                writer.write(message)
    mapped = slam.run(tmp_path / "scans.mcap")
    assert len(mapped.walls) >= 4
    assert mapped.odometry.shape == (0, 3)
    assert mapped.truth is None
    assert mapped.interpretations == ["no odometry in it; mapped by the scans alone"]


def test_doubts_and_timing_are_those_of_wclm_run(wclm: Any, tmp_path: Path) -> None:
    """The mount is unknown, so walls are not where they are: that must not be lost with the console of `wclm run`."""
    with McapWriter(tmp_path / "drive.mcap") as writer:
        for message in Simulation("room", seed=1, duration=4.0):
            writer.write(replace(message, mount=None) if isinstance(message, Scan) else message)
    mapped = slam.run(tmp_path / "drive.mcap")
    assert mapped.doubts == [UNKNOWN_MOUNT]
    assert UNKNOWN_MOUNT in mapped._repr_html_()
    mapped.save(tmp_path / "saved")
    assert wclm("run", "drive.mcap", "--out", "map", "--no-review").exit_code == 0
    saved, written = (json.loads((tmp_path / name / "summary.json").read_text()) for name in ("saved", "map"))
    for name in ("gaps", "timing", "interpretations", "doubts", "lidars"):
        assert saved[name] == written[name]


@pytest.mark.parametrize(
    ("call", "problem"),
    [
        (lambda mapped: mapped.occupancy("a"), "resolution must be a number of metres, not str"),
        (lambda mapped: mapped.plot(3), "path must be the name of a file or directory, not int"),
        (lambda mapped: mapped.save(None), "directory must be the name of a file or directory, not NoneType"),
        (lambda mapped: mapped.svg("all"), "measurements must be a list of Measurement, not str"),
        (lambda mapped: mapped.svg([3]), "each of measurements must be Measurement, not int"),
        (lambda mapped: mapped.slam.keyframe_covariance(0.5), "index must be a whole number, not float"),
        (lambda mapped: slam.save_run(mapped, mapped.finished, "a"), "pipeline must be a Slam, not MappedRecording"),
        (lambda mapped: slam.save_run(mapped.slam, mapped, "a"), "finished must be what finish.. has returned, not"),
        (lambda mapped: slam.run(ROOM, continue_=mapped), "continue_ must be the name of .*, not MappedRecording"),
        (
            lambda mapped: slam.run(ROOM, plan="a.dxf", plan_layer="walls"),
            "plan_layer must be a list of names, not str",
        ),
        (lambda mapped: slam.load_config({}), "path must be the name of a file or directory, not dict"),
        (lambda mapped: slam.load_config(None, "a.b=1"), "overrides must be a list of texts, not str"),
        (lambda mapped: drivers.open(None), "spec must be the name of a file or directory, not NoneType"),
        (lambda mapped: drivers.inspect("a.clf"), "source must be a source, as drivers.open returns, not str"),
    ],
)
def test_arguments_of_other_types_are_refused_in_one_line(
    mapped: slam.MappedRecording, call: Callable[[Any], Any], problem: str
) -> None:
    with pytest.raises(ArgumentError, match=problem) as raised:
        call(mapped)
    assert "\n" not in str(raised.value)


def test_a_wrong_name_is_one_line() -> None:
    with pytest.raises(SlamError, match=r"^nowhere.mcap: [^\n]*$"):
        slam.run("nowhere.mcap")
