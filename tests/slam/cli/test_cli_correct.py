"""`wclm correct` on simulated drives: pins, deleted and tied walls, and undoing them."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import drivers
from drivers import se2
from drivers.elapsed import elapsed
from drivers.messages import GroundTruth
from drivers.simulation import LidarModel, Simulation
from slam.evaluation.metrics import score_reference
from slam.io.output_dir import (
    CLOSURE_PICTURE,
    KEYFRAMES,
    MAP,
    PICTURE,
    PLAN_DIFFERENCES,
    PLAN_PICTURE,
    REPORT,
    SUMMARY,
    TRAJECTORY,
)
from slam.io.run_results import read_run_results
from slam.io.sessions import read_session
from slam.io.tum import Trajectory, read_tum
from slam.io.wall_maps import read_wall_map
from slam.mapping.convergence import converge

SURVEY = np.array([120.0, 40.0, -1.1])
"""Pose of the simulated world in the frame of the survey."""
SIGMA = 0.002
HEADER = "kind,id,x,y,sigma\n"


@pytest.fixture(scope="module")
def mapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("corrected")


def copy_of_run(wclm: Any, mapped: Path, source: str, target: Path) -> Path:
    """Return a copy of the output directory of a drive, which is mapped once."""
    made = mapped / source.split("?")[0].removeprefix("sim:")
    if not made.exists():
        result = wclm("run", source, "--out", made, "--no-review")
        assert result.exit_code == 0, result.output
    return Path(shutil.copytree(made, target))


@pytest.fixture
def session(wclm: Any, mapped: Path, tmp_path: Path) -> Path:
    return copy_of_run(wclm, mapped, "sim:room?seed=1&lidar=short", tmp_path / "out")


def driven_poses() -> list[GroundTruth]:
    """Return the true poses of the drive, without measuring its scans."""
    drive = Simulation("room", seed=1, lidar=LidarModel(beams=2, rate=0.5))
    return [message for message in drive if isinstance(message, GroundTruth)]


@pytest.fixture
def pins(tmp_path: Path) -> Path:
    """Survey of the robot at five times, of which the fourth is wrong by 10 cm."""
    rng = np.random.default_rng(1)
    truth = driven_poses()
    rows = []
    for k, place in enumerate(np.linspace(len(truth) // 10, len(truth) - 2, 5).astype(int)):
        x, y = se2.compose(SURVEY, truth[place].pose)[:2] + rng.normal(0.0, SIGMA, 2)
        rows.append(f"pose,{truth[place].stamp:.6f},{x + 0.1 * (k == 3):.5f},{y:.5f},{SIGMA}\n")
    (tmp_path / "pins.csv").write_text(HEADER + "".join(rows))
    return tmp_path / "pins.csv"


@pytest.mark.slow
def test_pins_move_the_map_into_the_survey_and_a_wrong_one_is_named(wclm: Any, session: Path, pins: Path) -> None:
    before, stated = read_run_results(session).walls, pins.read_text().splitlines()[4].split(",")
    result = wclm("correct", session, "--pins", pins)
    assert result.exit_code == 0, result.output
    left_out = [line for line in result.stdout.splitlines() if "LEFT OUT" in line]
    assert len(left_out) == 1
    assert f"pose at {float(stated[1]):.12g} s" in left_out[0]
    truth = {m.stamp: m.pose for m in driven_poses()}
    path, stamps = read_tum(session / TRAJECTORY), np.array(list(truth))
    nearest = np.abs(path.stamps[:, None] - stamps[None]).argmin(axis=1)
    same = np.abs(path.stamps - stamps[nearest]) < 1e-4
    true_poses = se2.compose(SURVEY, np.array(list(truth.values()))[nearest[same]])
    error = se2.between(true_poses, path.poses[same])
    assert same.sum() > 10
    assert np.sqrt((error[:, :2] ** 2).sum(axis=1).mean()) < 0.005
    assert np.abs(error[:, 2]).max() < 0.01
    after = read_run_results(session).walls
    np.testing.assert_array_equal(after.identity, before.identity)
    wall_map = read_wall_map(session)  # other commands use the pinned map
    np.testing.assert_allclose(wall_map.walls.frame, after.frame, atol=1e-3)
    assert np.sqrt(wall_map.covariance[0, 0]) < 0.01
    assert "Manual corrections" in (session / REPORT).read_text()
    assert len(read_session(session).slam_state.mapper.graph.pins()) == 4


@pytest.mark.slow
def test_a_pinned_point_on_a_wall_moves_it(wclm: Any, session: Path, tmp_path: Path) -> None:
    """Pins of the walls of one corner, in nearly the frame of the map, and the distance from the opposite wall."""
    walls = read_wall_map(session)
    rows = []
    for k, identity in enumerate(walls.walls.identity[:4].tolist()):
        for along in (walls.walls.low[k], walls.walls.high[k]):
            x, y = walls.point(k, along) + np.array([0.3, -0.2])
            rows.append(f"wall,{identity},{x:.5f},{y:.5f},0.001\n")
    (tmp_path / "walls.csv").write_text(HEADER + "".join(rows))
    result = wclm("correct", session, "--pins", tmp_path / "walls.csv")
    assert result.exit_code == 0, result.output
    assert "LEFT OUT" not in result.stdout
    moved = read_wall_map(session)
    shift = np.array([moved.normal(k) @ (np.array([0.3, -0.2])) for k in range(4)])
    offset = [
        moved.normal(k) @ (moved.walls.frame[k, :2] - walls.point(k, walls.along(k, moved.walls.frame[k, :2])))
        for k in range(4)
    ]
    np.testing.assert_allclose(offset, shift, atol=0.004)


def test_a_deleted_wall_is_gone_and_undoing_restores_all_results(wclm: Any, session: Path) -> None:
    of_the_run = {"unfinished": True, "plan": {"file": "a.svg", "recognised": False}}
    (session / SUMMARY).write_text(json.dumps(json.loads((session / SUMMARY).read_text()) | of_the_run))
    files = {name: (session / name).read_bytes() for name in (TRAJECTORY, KEYFRAMES, MAP, SUMMARY)}
    wall = int(read_run_results(session).walls.identity[0])
    assert wclm("map", session, "--format", "svg").exit_code == 0
    for name in (PICTURE, CLOSURE_PICTURE, PLAN_DIFFERENCES, PLAN_PICTURE):  # which only the run can make
        files[name] = name.encode()
        (session / name).write_bytes(files[name])
    removed = "closure.png, map.png, map.svg, plan.geojson, plan.svg"
    shown = wclm("correct", session, "--delete-wall", wall).stdout
    assert f"removed, as they show the map before: {removed}" in shown
    assert not any((session / name).exists() for name in removed.split(", "))
    assert wall not in read_run_results(session).walls.identity
    assert not of_the_run.keys() & read_run_results(session).summary.keys()
    mapper = read_session(session).slam_state.mapper
    converge(mapper)
    assert not mapper.landmarks.walls.rows["in_graph"][wall]
    assert wall in mapper.landmarks.deleted_walls()  # so the session is neither merged nor, if continued, refined
    other = int(read_run_results(session).walls.identity[0])
    assert wclm("correct", session, "--delete-wall", other).exit_code == 0
    listed = wclm("correct", session, "--list").stdout.splitlines()
    assert listed == [f"1: wall {wall} is deleted", f"2: wall {other} is deleted"]
    assert wclm("correct", session, "--undo").exit_code == 0
    present = read_run_results(session).walls.identity
    assert other in present
    assert wall not in present
    assert "removed" not in wclm("correct", session, "--undo").stdout
    assert {name: (session / name).read_bytes() for name in files} == files
    assert wclm("correct", session, "--list").stdout == "no corrections\n"


@pytest.mark.slow
def test_tied_walls_become_one_and_another_directory_can_be_written(wclm: Any, mapped: Path, tmp_path: Path) -> None:
    session = copy_of_run(wclm, mapped, "sim:office?seed=3&duration=20&lidar=short", tmp_path / "out")
    before = (session / MAP).read_bytes()
    walls = read_wall_map(session).walls
    relative = se2.between(walls.frame[:, None], walls.frame[None])
    collinear = (np.abs(relative[..., 2]) < 0.02) & (np.abs(relative[..., 1]) < 0.02)
    np.fill_diagonal(collinear, False)
    kept, absorbed = (int(walls.identity[row]) for row in np.argwhere(collinear)[0])
    result = wclm("correct", session, "--tie", f"{kept},{absorbed}", "--out", "tied")
    assert result.exit_code == 0, result.output
    assert "standard deviations" in result.stdout
    tied = read_run_results(Path("tied")).walls
    assert kept in tied.identity
    assert absorbed not in tied.identity
    row, earlier = tied.identity.tolist().index(kept), walls.identity.tolist().index(kept)
    assert tied.high[row] - tied.low[row] > walls.high[earlier] - walls.low[earlier]
    assert (session / MAP).read_bytes() == before
    assert json.loads(Path("tied", SUMMARY).read_text())["corrections"][0]["text"] == (
        f"walls {kept} and {absorbed} are one"
    )
    wclm.refuses("optimize", "tied", "--out", "refined", because=["has manual corrections"])


@pytest.mark.slow
def test_loops_are_forbidden_and_closed_by_hand(wclm: Any, mapped: Path, tmp_path: Path) -> None:
    """A drive with worn wheels closes loops: the error grows without them, and is the same with them again."""
    source = "sim:square?seed=1&lidar=short&odometry=bad"
    session = copy_of_run(wclm, mapped, source, tmp_path / "out")
    truth = [m for m in drivers.open(source) if isinstance(m, GroundTruth)]
    true_path = Trajectory(np.array([m.stamp for m in truth]), np.array([m.pose for m in truth]))
    loops = read_run_results(session).summary["slam"]["loop_decisions"]
    assert {row["status"] for row in loops} == {"accepted"}

    def error() -> float:
        return float(score_reference(read_tum(session / TRAJECTORY), true_path).figures()["ate_rmse"])

    with_loops, walls = error(), len(read_run_results(session).walls)
    forbid = [option for row in loops for option in ("--forbid-loop", row["candidate"])]
    assert wclm("correct", session, *forbid).exit_code == 0
    opened = read_run_results(session)
    assert error() > 3.0 * with_loops
    assert len(opened.walls) > walls + 20
    assert {row["status"] for row in opened.summary["slam"]["loop_decisions"]} == {"forbidden"}
    assert opened.summary["slam"]["loops"]["accepted"] == 0
    assert f"{len(loops)} forbidden by hand" in (session / REPORT).read_text()
    assert opened.keyframes is not None
    stamps, begin = opened.keyframes.stamps, opened.trajectory.stamps[0]
    # The building looks the same from all four sides, but the middles of a corridor and of a room do not look alike.
    true = true_path.poses[np.abs(true_path.stamps[:, None] - stamps).argmin(axis=0), :2]
    corridor, room = (int(np.hypot(*(true - place).T).argmin()) for place in ([12.5, 0.0], [-12.5, 12.5]))
    files = {name: (session / name).read_bytes() for name in (TRAJECTORY, KEYFRAMES, MAP, SUMMARY)}
    wclm.refuses("correct", session, *forbid[:2], because=["it is forbidden"])
    wclm.refuses("correct", session, "--close", f"{corridor},{room}", because=["not one place", "fit"])
    assert {name: (session / name).read_bytes() for name in files} == files
    # By their numbers, and at the end of the drive, where the way since the last loop has drifted, by stamps.
    close = [option for row in loops for option in ("--close", row["candidate"])]
    first_pass = opened.keyframes.stamps < stamps[loops[0]["keyframe"]] - 60.0
    old = int(np.flatnonzero(first_pass)[np.hypot(*(true[first_pass] - true[-1]).T).argmin()])
    close += ["--close", f"{stamps[old]}s,{elapsed(stamps[-1] - begin)}"]
    result = wclm("correct", session, *close)
    assert result.exit_code == 0, result.output
    assert result.stdout.count("of the points fit") == len(loops) + 1
    assert abs(error() - with_loops) < 0.05
    closed = read_run_results(session)
    assert abs(len(closed.walls) - walls) < 5
    assert closed.summary["slam"]["loops"]["accepted"] == len(loops) + 1
    assert read_session(session).slam_state.loops.state.candidates == len(loops) + 1  # a continued run numbers on
    for _ in range(len(loops) + 1):
        assert wclm("correct", session, "--undo").exit_code == 0
    assert {name: (session / name).read_bytes() for name in files} == files


@pytest.mark.slow
def test_mistakes_are_refused_and_change_nothing(wclm: Any, session: Path, tmp_path: Path) -> None:
    files = {file: file.read_bytes() for file in session.rglob("*") if file.is_file()}
    (tmp_path / "one.csv").write_text(HEADER + "pose,10,1,2,0.01\n")
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "late.csv").write_text(HEADER + "pose,1e6,1,2,0.01\n")
    (tmp_path / "unknown.csv").write_text(HEADER + "wall,999,1,2,0.01\n")
    wclm.refuses("correct", session, because=["--list or --undo"])
    wclm.refuses("correct", session, "--undo", because=["has no corrections"])
    wclm.refuses("correct", tmp_path / "nowhere", "--undo", because=["nowhere: no such directory"])
    wclm.refuses("correct", tmp_path / "nowhere", "--list", because=["nowhere: no such directory"])
    wclm.refuses("correct", tmp_path, "--list", because=["has no map.json"])
    wclm.refuses("correct", session, "--delete-wall", 999, because=["no wall 999"])
    wclm.refuses("correct", session, "--tie", "0,1", because=["cannot be one"])
    wclm.refuses("correct", session, "--tie", "0", because=["two identities"])
    wclm.refuses("correct", session, "--close", 5000 * "1", because=["number of a loop"])
    wclm.refuses("correct", session, "--close", "1", because=["no loop 1"])
    wclm.refuses("correct", session, "--forbid-loop", 1, because=["no loop 1"])
    wclm.refuses("correct", session, "--close", "0,20", because=["m of driving apart"])
    wclm.refuses("correct", session, "--close", "0,4000", because=["no keyframe 4000"])
    wclm.refuses("correct", session, "--close", "1s,4000s", because=["4000 s: there is no keyframe"])
    wclm.refuses("correct", session, "--close", "1s,nans", because=["--close", "stamps as"])
    wclm.refuses(
        "correct",
        session,
        "--close",
        "0:01,90:00",
        because=["5400 s: there is no keyframe", "1:30:00 after the first one; the nearest is keyframe "],
    )
    wclm.refuses("correct", session, "--close", "0:01,0:x", because=["--close", "times as 0:08"])
    wclm.refuses("correct", session, "--close", "0,1,2", because=["--close", "two keyframes"])
    wclm.refuses(
        "correct", session, "--pins", tmp_path / "one.csv", because=["one.csv: ", "do not determine the place"]
    )
    wclm.refuses("correct", session, "--pins", tmp_path / "empty.csv", because=["empty.csv: is empty"])
    wclm.refuses("correct", session, "--pins", tmp_path / "late.csv", because=["late.csv: ", "there is no scan"])
    wclm.refuses("correct", session, "--pins", tmp_path / "unknown.csv", because=["unknown.csv: ", "no wall 999"])
    assert {file: file.read_bytes() for file in session.rglob("*") if file.is_file()} == files
