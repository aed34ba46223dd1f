"""Sessions joined: right where they are of one building, refused where they are not, and never in between."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
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
from slam import Slam
from slam.cli.app import app
from slam.config import config_to_toml
from slam.errors import MapError
from slam.evaluation.benchmarks.relocalisation import halves
from slam.evaluation.metrics import read_relations, score_reference, score_relations
from slam.io.map_json import read_map
from slam.io.output_dir import CONFIG, RESULTS
from slam.io.sessions import Recording, StoredSession, read_session, write_session
from slam.io.tum import Trajectory, read_tum
from slam.loop_closure.relocalisation import PlaceVerdict, Relocalisation
from slam.offline.map_merging import Agreement, join
from slam.offline.map_merging.consensus import Recognised, independent, largest_agreement
from slam.offline.map_merging.transfer import shift_after, shifted
from slam.optimisation import optimise

from ...recordings import recording_file

OFFICE = {"first": ("sim:office?seed=1&duration=75", 0.0), "second": ("sim:office?seed=2&duration=90", 15.0)}
"""Two drives through one building, and from when on each is looked at: the second begins within the first's way."""


def mapped(messages: Sequence[Message], name: str, directory: Path) -> Path:
    """The directory of a run over some messages, as far as a session goes."""
    slam = Slam()
    for message in messages:
        slam.add(message)
    slam.finish()
    session = slam.session
    session.recordings.append(Recording(name=name, path=None, first=messages[0].stamp, last=messages[-1].stamp))
    directory.mkdir()
    (directory / CONFIG).write_text(config_to_toml(session.config))
    write_session(directory, session)
    return directory


def messages_of(name: str) -> list[Message]:
    spec, since = OFFICE[name]
    return [message for message in drivers.open(spec) if message.stamp >= since]


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("sessions")
    left = {name: mapped(messages_of(name), name, folder / name) for name in OFFICE}
    return left | {"other": mapped(list(drivers.open("sim:equal_doors?duration=20")), "other", folder / "other")}


def read(sessions: dict[str, Path], *names: str) -> list[tuple[str, StoredSession]]:
    return [(name, read_session(sessions[name])) for name in names]


# Joined


@pytest.fixture(scope="module")
def both(sessions: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("joined") / "both"
    command = ["merge", *(str(sessions[name]) for name in OFFICE), "--out", str(out), "--no-review"]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    assert "joined     " in result.stdout
    return out


def test_two_drives_through_one_building_become_one_map(both: Path, sessions: dict[str, Path]) -> None:
    path, recordings = read_tum(both / "trajectory.tum"), read_session(both).recordings
    assert [recording.name for recording in recordings] == ["first", "second"]
    truth = [
        (message.stamp + recording.shift, *message.pose)
        for recording in recordings
        for message in messages_of(recording.name)
        if isinstance(message, GroundTruth)
    ]
    told = np.array(truth)
    score = score_reference(path, Trajectory(told[:, 0], told[:, 1:]))
    assert score.figures()["ate_max"] < 0.03
    alone = [len(session.slam_state.mapper.landmarks.walls) for _, session in read(sessions, "first", "second")]
    assert len(read_map(both / "map.json").lines) < 0.75 * sum(alone)
    np.testing.assert_allclose(path.poses[0], np.zeros(3), atol=5e-3)  # in the frame of the first


def test_clocks_are_told_apart(both: Path) -> None:
    first, second = read_session(both).recordings
    assert first.shift == 0.0
    assert second.shift > 35.0
    assert second.first > first.last
    assert (np.diff(read_tum(both / "trajectory.tum").stamps) > 0).all()


def test_a_joined_session_is_a_session(both: Path, sessions: dict[str, Path]) -> None:
    assert {entry.name for entry in both.iterdir()} == RESULTS - {"map.png", "review.rrd"}
    summary = json.loads((both / "summary.json").read_text())
    assert summary["joined"][0]["independent"] >= 3
    assert 60 < summary["path_length"] < 80
    (_, first), (_, second), (_, joined) = read(sessions | {"both": both}, "first", "second", "both")
    assert len(joined.odometry) == len(joined.starts) == 2
    assert len(joined.scans) == len(first.scans) + len(second.scans)
    path, last = read_tum(both / "trajectory.tum"), joined.scans[-1].stamp
    told = [np.interp(last, path.stamps, path.poses[:, k]) for k in range(2)]
    np.testing.assert_allclose(joined.slam_state.pose[:2], told, atol=0.005)
    with pytest.raises(MapError, match="other: is not recognised in both"):
        join([("both", joined), *read(sessions, "other")])


# Refused


@pytest.mark.parametrize("names", [("first", "other"), ("other", "second")])
def test_another_building_is_refused_by_name(sessions: dict[str, Path], names: tuple[str, ...]) -> None:
    with pytest.raises(MapError, match=f"^{'second' if names[0] == 'other' else 'other'}: is not recognised in "):
        join(read(sessions, *names))


def test_what_is_asked_for_wrongly_is_one_line(wclm: Any, sessions: dict[str, Path]) -> None:
    wclm.refuses("merge", sessions["first"], "nowhere", "--out", "out", because=["nowhere: is not a directory"])
    wclm.refuses("merge", sessions["first"], sessions["other"], "--out", "out", because=["other: is not recognised"])
    assert wclm("merge", sessions["first"], "--out", "out").exit_code == 2
    assert not Path("out").exists()


def test_what_was_seen_once_does_not_count_twice(both: Path, sessions: dict[str, Path]) -> None:
    with pytest.raises(MapError, match="first: the recording first in it is in both, too"):
        join(read(sessions | {"both": both}, "both", "first"))


def test_a_session_without_a_map_is_refused(sessions: dict[str, Path]) -> None:
    empty = Slam()
    session = read_session(sessions["first"])
    session.slam_state = empty.slam_state
    with pytest.raises(MapError, match="first: has no keyframe"):
        join([("first", session), *read(sessions, "second")])


# The order


@dataclass
class Visit:
    """A session by the rooms that it saw; two are recognised in each other where they share one."""

    rooms: frozenset[int]
    recordings: tuple[Recording, ...] = ()

    @property
    def slam_state(self) -> SimpleNamespace:
        return SimpleNamespace(mapper=SimpleNamespace(keyframe_count=1, converge=lambda: None, rooms=self.rooms))

    def drive(self) -> None: ...


@pytest.fixture
def visits(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    module = import_module("slam.offline.map_merging.merge")

    def locate(mapper: Any, drive: None, index: Any) -> Agreement:
        shared = len(mapper.rooms & index.rooms)
        return Agreement(9, 3 * shared, [PIECES[0]] * 3 * shared, 3 * shared)

    monkeypatch.setattr(module, "index_map", lambda mapper: mapper)
    monkeypatch.setattr(module, "locate", locate)
    monkeypatch.setattr(module, "united", lambda whole, session, _: Visit(whole.rooms | session.rooms))
    rooms = {"east": {1, 2}, "west": {4, 5}, "middle": {2, 3, 4}, "elsewhere": {9}}
    return {name: Visit(frozenset(some)) for name, some in rooms.items()}


def test_a_session_is_joined_by_way_of_another(visits: dict[str, Any]) -> None:
    joined = join([(name, visits[name]) for name in ("east", "west", "middle")])
    assert [name for name, _ in joined.found] == ["middle", "west"]
    assert joined.session.rooms == {1, 2, 3, 4, 5}  # type: ignore[attr-defined]


def test_one_that_nothing_leads_to_is_refused(visits: dict[str, Any]) -> None:
    with pytest.raises(MapError, match="elsewhere: is not recognised in east, middle: none of 9 pieces"):
        join([(name, visits[name]) for name in ("east", "elsewhere", "middle")])


# Agreement


def recognised(pose: Sequence[float], motion: Sequence[float], walls: Sequence[int], score: float = 10.0) -> Recognised:
    verdict = PlaceVerdict(True, True, "", 1.0, 10.0, len(walls), 0, 1.0, 0.0, 0.01, 0.01, score, 0.0)
    place = se2.compose(np.array(motion), np.array(pose))
    pairs = np.column_stack([walls, walls])
    return Recognised(range(2), np.array(pose), Relocalisation(place, np.eye(3), np.array(motion), pairs, verdict))


def verdict_on(pieces: Sequence[Recognised]) -> Agreement:
    members = largest_agreement(pieces)
    return Agreement(20, len(pieces), members, independent(members))


RIGHT, WRONG = (4.0, -2.0, 1.0), (4.0, 1.0, 1.0)
PIECES = [recognised((5.0 * k, 3.0, 0.5), RIGHT, range(10 * k, 10 * k + 8)) for k in range(5)]


def test_pieces_that_agree_on_walls_of_their_own_are_believed() -> None:
    agreement = verdict_on(PIECES)
    assert agreement.accepted
    assert (len(agreement.members), agreement.independent) == (5, 5)


def test_one_piece_otherwise_among_many_is_left_out() -> None:
    agreement = verdict_on([recognised((0.0, 0.0, 0.0), WRONG, range(100, 108)), *PIECES])
    assert agreement.accepted
    assert all(member in PIECES for member in agreement.members)


def test_two_pieces_are_too_few() -> None:
    assert not verdict_on(PIECES[:2]).accepted


def test_the_same_walls_again_and_again_are_no_more_than_once() -> None:
    agreement = verdict_on([recognised((5.0, 3.0, 0.1 * k), RIGHT, range(k, k + 8)) for k in range(4)])
    assert agreement.independent == 1
    assert not agreement.accepted


def test_pieces_at_odds_are_not_believed() -> None:
    others = [recognised((5.0 * k, 9.0, 0.0), WRONG, range(200 + 10 * k, 208 + 10 * k)) for k in range(3)]
    agreement = verdict_on([*PIECES, *others])
    assert len(agreement.members) == 5
    assert not agreement.accepted
    assert "3 say otherwise" in agreement.reason


def test_a_bent_map_agrees_with_itself() -> None:
    bent = [
        recognised((5.0 * k, 0.0, 0.0), (RIGHT[0], RIGHT[1] + 0.1 * k, RIGHT[2]), range(9 * k, 9 * k + 8))
        for k in range(5)
    ]
    assert verdict_on(bent).accepted


def test_nothing_recognised_is_no_agreement() -> None:
    agreement = verdict_on([])
    assert not agreement.accepted
    assert "none of 20 pieces" in agreement.reason


def test_a_session_that_is_later_keeps_its_clock(sessions: dict[str, Path]) -> None:
    (_, session), *_ = read(sessions, "second")
    assert shift_after(session, 14.0) == 0.0
    shift = shift_after(session, 1000.5)
    moved = shifted(session, shift)
    assert moved.scans[0].stamp > 1000.5
    assert [some.stamp for some in moved.scans] == [some.stamp + shift for some in session.scans]


# The public recordings


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", ["intel", "csail"])
def test_halves_mapped_apart_and_joined_are_as_accurate_as_the_whole(name: str, tmp_path: Path) -> None:
    messages = list(drivers.open(recording_file(name, "clf")))
    relations = read_relations(recording_file(name, "relations"))
    whole = Slam(refine=True)
    for message in messages:
        whole.add(message)
    uncut = whole.finish()
    first, second = halves(messages)
    left = {"a": mapped(first, "a", tmp_path / "a"), "b": mapped(second, "b", tmp_path / "b")}
    apart = read(left, "a", "b")
    joined = optimise(join(apart).session).finished
    figures, expected = (
        score_relations(Trajectory(some.stamps, some.poses), relations).figures() for some in (joined, uncut)
    )
    assert figures["missing"] == 0
    assert figures["trans_mean"] < 1.1 * expected["trans_mean"]
    assert figures["rot_mean"] < 1.1 * expected["rot_mean"]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_public_buildings_are_not_taken_for_each_other(tmp_path: Path) -> None:
    names = ("intel", "fr079", "csail")
    left = {name: mapped(list(drivers.open(recording_file(name, "clf"))), name, tmp_path / name) for name in names}
    for first in names:
        for second in names:
            if first != second:
                with pytest.raises(MapError, match=f"{second}: is not recognised in {first}"):
                    join([(name, read_session(left[name])) for name in (first, second)])
