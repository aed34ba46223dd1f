"""Sessions of one building are merged correctly, sessions of different buildings are refused."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import drivers
from drivers import se2
from drivers.messages import GroundTruth, Message
from drivers.simulation import LIDAR_MODELS, WHEEL_MODELS, Simulation
from slam import Slam
from slam.cli.app import app
from slam.config import config_to_toml
from slam.errors import MapError
from slam.estimation.map_view import map_features
from slam.evaluation.benchmarks.relocalisation import split_halves
from slam.evaluation.metrics import read_relations, score_reference, score_relations
from slam.geometry.segments import Floats
from slam.graph.range_bias import RangeBias
from slam.io.map_json import read_map
from slam.io.output_dir import CONFIG, RESULTS
from slam.io.sessions import Recording, StoredSession, read_session, write_session
from slam.io.sessions.corrections import LoopForbidding
from slam.io.tum import Trajectory, read_tum
from slam.mapping.convergence import converge
from slam.mapping.manual_changes import delete_wall
from slam.offline.corrections.loops import LoopCorrector
from slam.offline.map_merging import merge_sessions
from slam.offline.map_merging.merge import different_ranges
from slam.offline.map_merging.session_scans import drive_of, map_of
from slam.offline.map_merging.transfer import clock_shift, shift_clock
from slam.offline.optimisation import optimise
from slam.recognition.location import OVERLAP, Expectation, Location, PlacedSubmap, locate

from ...recordings import recording_file

pytestmark = pytest.mark.shared_run

OFFICE = {
    "first": (1, 0.0, 45.0),
    "second": (2, 15.0, 50.0),
}
"""Seeds of two drives through one building, and the times in seconds from and up to which each is used: the second
starts on the path of the first."""
LIDAR = replace(LIDAR_MODELS["short"], beams=180, rate=2.5)
REJECTED = {
    **{"candidate": 1, "stamp": 20.0, "keyframe": 5, "old": 2, "status": "rejected", "reason": "an example"},
    **{"matches": 3, "merged": 0, "motion": [0.1, 0.0, 0.0], "overlap_ratio": 0.9, "runner_up": 0.5, "sigma": 0.1},
    **{"contradicted": 0.0, "shift": 0.0},
}
"""Loop decision of each session."""


def mapped(messages: Sequence[Message], name: str, directory: Path) -> Path:
    """Map the messages and write the session; return the directory."""
    slam = Slam()
    for message in messages:
        slam.add(message)
    slam.finish()
    session = slam.session
    session.loop_decisions = [REJECTED]  # as if a place had looked known
    session.recordings.append(Recording(name=name, path=None, first=messages[0].stamp, last=messages[-1].stamp))
    directory.mkdir()
    (directory / CONFIG).write_text(config_to_toml(session.config))
    write_session(directory, session)
    return directory


@cache
def messages_of(name: str) -> list[Message]:
    seed, start, stop = OFFICE[name]
    return [m for m in Simulation("office", seed=seed, duration=stop, lidar=LIDAR) if m.stamp >= start]


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("sessions")
    written = {name: mapped(messages_of(name), name, folder / name) for name in OFFICE}
    elsewhere = list(Simulation("equal_doors", duration=20.0, lidar=LIDAR))
    return written | {"other": mapped(elsewhere, "other", folder / "other")}


def read(sessions: dict[str, Path], *names: str) -> list[tuple[str, StoredSession]]:
    return [(name, read_session(sessions[name])) for name in names]


# Merged


@pytest.mark.parametrize(
    ("bias", "sigma", "told"), [(0.03, 0.001, True), (-0.03, 0.001, True), (0.009, 0.001, False), (0.03, 0.007, False)]
)
def test_lidars_of_clearly_different_range_biases_are_a_warning(bias: float, sigma: float, told: bool) -> None:
    biases = [("old", RangeBias(0.0, 0.001)), ("same", RangeBias(0.002, 0.001)), ("new", RangeBias(bias, sigma))]
    texts = different_ranges([*biases, ("unknown", RangeBias())])
    direction = "longer" if bias > 0.0 else "shorter"
    assert [
        text.startswith(f"new: its ranges are 0.030 ± 0.001 m {direction} than those of old") for text in texts
    ] == ([True] if told else [])


@pytest.fixture(scope="module")
def both(sessions: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("merged") / "both"
    command = ["merge", *(str(sessions[name]) for name in OFFICE), "--out", str(out), "--no-review"]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    assert "joined     " in result.stdout
    return out


def test_two_drives_through_one_building_are_merged_into_one_map(both: Path, sessions: dict[str, Path]) -> None:
    path, recordings = read_tum(both / "trajectory.tum"), read_session(both).recordings
    assert [recording.name for recording in recordings] == ["first", "second"]
    truth = [
        (message.stamp + recording.shift, *message.pose)
        for recording in recordings
        for message in messages_of(recording.name)
        if isinstance(message, GroundTruth)
    ]
    rows = np.array(truth)
    score = score_reference(path, Trajectory(rows[:, 0], rows[:, 1:]))
    assert score.figures()["ate_max"] < 0.03
    walls = [len(session.slam_state.mapper.landmarks.walls) for _, session in read(sessions, "first", "second")]
    assert len(read_map(both / "map.json").walls) < 0.75 * sum(walls)
    np.testing.assert_allclose(path.poses[0], np.zeros(3), atol=5e-3)  # the first's frame


def test_clock_of_the_second_session_is_shifted_after_the_first(both: Path) -> None:
    first, second = read_session(both).recordings
    assert first.shift == 0.0
    assert second.shift > 25.0
    assert second.first > first.last
    assert (np.diff(read_tum(both / "trajectory.tum").stamps) > 0).all()


def test_merged_session_is_complete(both: Path, sessions: dict[str, Path]) -> None:
    assert {entry.name for entry in both.iterdir()} == RESULTS - {"map.png", "review.rrd"}
    summary = json.loads((both / "summary.json").read_text())
    assert summary["joined"][0]["placed"] >= 3
    assert 32 < summary["path_length"] < 42
    (_, first), (_, second), (_, merged) = read(sessions | {"both": both}, "first", "second", "both")
    assert len(merged.odometry) == len(merged.starts) == 2
    assert len(merged.scans) == len(first.scans) + len(second.scans)
    path, last = read_tum(both / "trajectory.tum"), merged.scans[-1].stamp
    expected = [np.interp(last, path.stamps, path.poses[:, k]) for k in range(2)]
    np.testing.assert_allclose(merged.slam_state.pose[:2], expected, atol=0.005)
    with pytest.raises(MapError, match="other: is not recognised in both"):
        merge_sessions([("both", merged), *read(sessions, "other")])


def test_loops_of_all_sessions_are_listed_with_numbers_of_their_own(both: Path, sessions: dict[str, Path]) -> None:
    slam, merged = json.loads((both / "summary.json").read_text())["slam"], read_session(both)
    assert slam["loops"] == {"proposed": 2, "rejected": 2, "accepted": 0, "retracted": 0}
    keyframes = read_session(sessions["first"]).slam_state.mapper.keyframe_count
    rows = [tuple(row[name] for name in ("candidate", "keyframe", "old")) for row in slam["loop_decisions"]]
    assert rows == [(1, 5, 2), (2, 5 + keyframes, 2 + keyframes)]
    assert merged.slam_state.loops.state.candidates == 2
    assert "an example" in (both / "report.html").read_text()
    with pytest.raises(MapError, match="there is no loop 3: the loops are 1, 2"):
        LoopCorrector(merged).forbid(LoopForbidding(loop=3), ())


# Refused


def test_session_of_another_building_is_refused_by_name(sessions: dict[str, Path]) -> None:
    """The second session; the command below is given them in the other order."""
    with pytest.raises(MapError, match=r"^second: is not recognised in "):
        merge_sessions(read(sessions, "other", "second"))


def test_command_refuses_wrong_input_with_one_line(wclm: Any, sessions: dict[str, Path]) -> None:
    wclm.refuses("merge", sessions["first"], "nowhere", "--out", "out", because=["nowhere: no such directory"])
    first, other = sessions["first"], sessions["other"]
    wclm.refuses("merge", first, other, "--out", "out", because=[f"wclm: {other}: is not recognised in {first}"])
    assert wclm("merge", sessions["first"], "--out", "out").exit_code == 2
    assert not Path("out").exists()


def test_recording_in_two_sessions_is_refused(both: Path, sessions: dict[str, Path]) -> None:
    with pytest.raises(MapError, match="first: contains the recording first, and so does both"):
        merge_sessions(read(sessions | {"both": both}, "both", "first"))


def test_session_without_keyframes_is_refused(sessions: dict[str, Path]) -> None:
    empty = Slam()
    session = read_session(sessions["first"])
    session.slam_state = empty.slam_state
    with pytest.raises(MapError, match="first: has no keyframe"):
        merge_sessions([("first", session), *read(sessions, "second")])


def test_session_whose_deleted_walls_or_pins_would_be_lost_is_not_merged(sessions: dict[str, Path]) -> None:
    deleted, pinned = read_session(sessions["second"]), read_session(sessions["second"])
    delete_wall(deleted.slam_state.mapper, int(map_features(deleted.slam_state.mapper)[0].identity[0]))
    graph = pinned.slam_state.mapper.graph
    graph.add_pinned_pose(0, np.zeros(3), np.eye(3))
    graph.update()
    for changed, changes in ((deleted, "walls that were deleted by hand"), (pinned, "pins")):
        with pytest.raises(MapError, match=f"second: has {changes}, which merging would drop"):
            merge_sessions([*read(sessions, "first"), ("second", changed)])
        for refine in (optimise, lambda session: Slam(resumed=session, refine=True)):
            with pytest.raises(MapError, match=f"has {changes}, which a refinement would drop"):
                refine(changed)


# Order

PLACED = PlacedSubmap(range(2), np.zeros(3), np.eye(3), np.zeros(3), np.zeros((0, 2), dtype=np.int64), 1.0, 1.0)


@dataclass
class FakeSession:
    """Session defined by the rooms it covers; it is recognised in another one that shares a room."""

    rooms: frozenset[int]
    recordings: tuple[Recording, ...] = ()

    @property
    def slam_state(self) -> SimpleNamespace:
        graph = SimpleNamespace(range_bias=RangeBias())
        return SimpleNamespace(mapper=SimpleNamespace(keyframe_count=1, rooms=self.rooms, graph=graph))


@pytest.fixture
def fake_sessions(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    module = import_module("slam.offline.map_merging.merge")

    def locate(new: FakeSession, old: FakeSession, _: Expectation) -> Location:
        shared = len(new.rooms & old.rooms)
        return Location(9, [PLACED] * shared, 20.0 * shared, 15.0, 20.0 * shared, f"they share {shared} rooms")

    monkeypatch.setattr(module, "converge", lambda mapper: 0)
    monkeypatch.setattr(module, "fragile_changes", lambda mapper: "")
    monkeypatch.setattr(module, "map_of", lambda session: session)
    monkeypatch.setattr(module, "drive_of", lambda session: session)
    monkeypatch.setattr(module, "locate", locate)
    monkeypatch.setattr(module, "merge_pair", lambda merged, session, _: FakeSession(merged.rooms | session.rooms))
    rooms = {"east": {1, 2}, "west": {4, 5}, "middle": {2, 3, 4}, "elsewhere": {9}}
    return {name: FakeSession(frozenset(some)) for name, some in rooms.items()}


def test_session_is_merged_by_way_of_another(fake_sessions: dict[str, Any]) -> None:
    merged = merge_sessions([(name, fake_sessions[name]) for name in ("east", "west", "middle")])
    assert [name for name, _ in merged.added] == ["middle", "west"]
    assert merged.session.rooms == {1, 2, 3, 4, 5}  # type: ignore[attr-defined]


def test_session_that_overlaps_no_other_is_refused(fake_sessions: dict[str, Any]) -> None:
    with pytest.raises(MapError, match="elsewhere: is not recognised in east, middle: they share 0 rooms"):
        merge_sessions([(name, fake_sessions[name]) for name in ("east", "elsewhere", "middle")])


@pytest.mark.parametrize(
    ("path", "hint"), [("drive.mcap", ""), (None, "; if these are two drives, save their runs under two names")]
)
def test_runs_of_one_name_and_time_count_as_one(fake_sessions: dict[str, Any], path: str | None, hint: str) -> None:
    recordings = (Recording(name="run", path=path, first=0.0, last=60.0),)
    twice = [(name, replace(fake_sessions[name], recordings=recordings)) for name in ("east", "middle")]
    with pytest.raises(MapError, match=f"^middle: contains the recording run, and so does east{hint}$"):
        merge_sessions(twice)


# Places that look alike

LOOKALIKE = {
    "there": ("corridor", 2, "good", 0.0, 42.0),
    "back": ("corridor", 3, "good", 113.0, 155.0),
    "one side": ("square", 2, "bad", 0.0, 46.0),
    "another side": ("square", 3, "bad", 115.0, 160.0),
}
"""Drives through a corridor with doors in both directions, and through a building with four equal sides, their
seeds and wheels, and the time in seconds from and up to which each is used."""


def scanned(name: str, directory: Path) -> tuple[StoredSession, Floats]:
    """Return the session of a drive, and the pose of its frame in the world."""
    world, seed, wheels, start, stop = LOOKALIKE[name]
    driven = Simulation(world, seed=seed, duration=stop, lidar=LIDAR, wheels=WHEEL_MODELS[wheels])
    messages = [message for message in driven if message.stamp >= start]
    session = read_session(mapped(messages, name, directory / name))
    converge(session.slam_state.mapper)
    return session, next(message.pose for message in messages if isinstance(message, GroundTruth))


@pytest.mark.slow
def test_corridor_is_recognised_although_each_of_its_places_looks_like_others(tmp_path: Path) -> None:
    (old, start), (new, turned) = scanned("there", tmp_path), scanned("back", tmp_path)
    for location, motion in (
        (locate(drive_of(new), map_of(old), OVERLAP), se2.between(start, turned)),
        (locate(drive_of(old), map_of(new), OVERLAP), se2.between(turned, start)),
    ):
        assert location.accepted, location.reason
        assert "fit in one place only" in location.reason
        errors = [se2.between(motion, member.motion) for member in location.members]
        assert len(errors) >= 3
        assert np.abs(errors).max() < 0.3


@pytest.mark.slow
def test_building_with_four_equal_sides_is_refused_and_its_places_are_named(tmp_path: Path) -> None:
    (old, _), (new, _) = scanned("one side", tmp_path), scanned("another side", tmp_path)
    location = locate(drive_of(new), map_of(old), OVERLAP)
    assert not location.accepted
    assert location.reason.startswith("it fits in several places, x ")
    assert location.reason.count("degrees") >= 2


def test_later_session_keeps_its_clock(sessions: dict[str, Path]) -> None:
    (_, session), *_ = read(sessions, "second")
    assert clock_shift(session, 14.0) == 0.0
    shift = clock_shift(session, 1000.5)
    moved = shift_clock(session, shift)
    assert moved.scans[0].stamp > 1000.5
    assert [some.stamp for some in moved.scans] == [some.stamp + shift for some in session.scans]


# Public recordings


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", ["intel", "csail"])
def test_merged_halves_are_as_accurate_as_the_whole(name: str, tmp_path: Path) -> None:
    messages = list(drivers.open(recording_file(name, "clf")))
    relations = read_relations(recording_file(name, "relations"))
    whole = Slam(refine=True)
    for message in messages:
        whole.add(message)
    expected_result = whole.finish()
    first, second = split_halves(messages)
    written = {"a": mapped(first, "a", tmp_path / "a"), "b": mapped(second, "b", tmp_path / "b")}
    merged = optimise(merge_sessions(read(written, "a", "b")).session).finished
    figures, expected = (
        score_relations(Trajectory(some.stamps, some.poses), relations).figures() for some in (merged, expected_result)
    )
    assert figures["missing"] == 0
    assert figures["trans_mean"] < 1.1 * expected["trans_mean"]
    assert figures["rot_mean"] < 1.1 * expected["rot_mean"]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_public_recordings_are_not_recognised_in_each_other(tmp_path: Path) -> None:
    names = ("intel", "fr079", "csail")
    written = {name: mapped(list(drivers.open(recording_file(name, "clf"))), name, tmp_path / name) for name in names}
    for first in names:
        for second in names:
            if first != second:
                with pytest.raises(MapError, match=f"{second}: is not recognised in {first}"):
                    merge_sessions([(name, read_session(written[name])) for name in (first, second)])
