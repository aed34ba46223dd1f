"""Mapping by the scans alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.messages import GroundTruth, Message, Scan
from drivers.recordings.mcap import McapWriter
from drivers.simulation import Simulation
from drivers.simulation.lidar_model import LidarModel
from slam import Config, Slam
from slam.cli.app import app
from slam.cli.commands.batch_worker import map_job
from slam.config import OdometryConfig, config_to_toml
from slam.evaluation.metrics import score_reference
from slam.events import Finished
from slam.io.output_dir import CONFIG, TRAJECTORY
from slam.io.sessions import read_session, write_session
from slam.io.tum import Trajectory
from slam.offline.batch import JobOptions, Status, make_jobs

WITHOUT_ODOMETRY = Config(odometry=OdometryConfig(source="none"))


def run(messages: list[Message]) -> Finished:
    slam = Slam(WITHOUT_ODOMETRY)
    for message in messages:
        slam.add(message)
    return slam.finish()


@pytest.fixture(scope="module")
def drive() -> list[Message]:
    return list(Simulation("office", seed=1, duration=15.0, lidar=LidarModel(beams=180, rate=5.0)))


@pytest.fixture(scope="module")
def result(drive: list[Message]) -> Finished:
    return run([message for message in drive if isinstance(message, Scan)])


def test_the_office_is_mapped_to_two_centimetres(drive: list[Message], result: Finished) -> None:
    truth = [message for message in drive if isinstance(message, GroundTruth)]
    reference = Trajectory(np.array([t.stamp for t in truth]), np.array([t.pose for t in truth]))
    assert score_reference(Trajectory(result.stamps, result.poses), reference).figures()["ate_rmse"] < 0.02
    assert not result.summary["suspects"]


def test_odometry_is_ignored(drive: list[Message], result: Finished) -> None:
    np.testing.assert_array_equal(run(drive).poses, result.poses)


def test_a_corridor_without_an_end_in_sight_is_named() -> None:
    lidar = LidarModel(beams=360, range_max=3.0)
    messages = [m for m in Simulation("bare_corridor", seed=1, duration=25.0, lidar=lidar) if isinstance(m, Scan)]
    summary = run(messages).summary
    assert "DEGENERATE" in [state["state"] for state in summary["states"]]
    assert "unconstrained" in [suspect["check"] for suspect in summary["suspects"]]


def test_a_recording_without_odometry_is_mapped_and_says_so(drive: list[Message], tmp_path: Path) -> None:
    recording = tmp_path / "scans.mcap"
    with McapWriter(recording) as writer:
        for message in drive:
            if isinstance(message, Scan) and message.stamp < 5.0:
                writer.write(message)
    ran = CliRunner().invoke(app, ["run", str(recording), "--out", str(tmp_path / "map"), "--no-review"])
    assert ran.exit_code == 0, ran.output
    assert "scans.mcap: no odometry in it" in " ".join(ran.output.split())
    (job,) = make_jobs([str(recording)], tmp_path / "batch", JobOptions(Config(), review=False))
    row = map_job(job)
    assert row.status is Status.DONE, row.error
    assert (job.directory / TRAJECTORY).read_bytes() == (tmp_path / "map" / TRAJECTORY).read_bytes()
    assert "scans.mcap: no odometry in it" in job.log.read_text()
    refined = CliRunner().invoke(app, ["optimize", str(recording), "--out", str(tmp_path / "fine"), "--no-review"])
    assert refined.exit_code == 0, refined.output
    assert "scans.mcap: no odometry in it" in " ".join(refined.output.split())
    again = ["run", "sim:room?duration=4", "--continue", str(tmp_path / "map"), "--out", str(tmp_path / "more")]
    ran = CliRunner().invoke(app, [*again, "--no-review"])
    assert ran.exit_code == 0, ran.output


def test_a_run_of_a_robot_that_stood_is_continued(drive: list[Message], tmp_path: Path) -> None:
    """No motion was long enough to learn the errors of predictions from."""
    first = next(message for message in drive if isinstance(message, Scan))
    slam = Slam(WITHOUT_ODOMETRY)
    for k in range(10):
        slam.add(replace(first, stamp=first.stamp + 0.2 * k))
    slam.finish()
    assert not len(slam.session.slam_state.odometry_model.samples)
    (tmp_path / CONFIG).write_text(config_to_toml(WITHOUT_ODOMETRY))
    write_session(tmp_path, slam.session)
    restored = read_session(tmp_path)
    np.testing.assert_array_equal(
        restored.slam_state.odometry_model.floors, slam.session.slam_state.odometry_model.floors
    )
