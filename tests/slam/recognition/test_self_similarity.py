"""A building of equal places is recognised as such, and a match in it counts only as far as its places differ."""

from __future__ import annotations

import math

import numpy as np
import pytest

from slam.estimation.slam_state import SlamState
from slam.recognition import self_similarity
from slam.recognition.drive_scans import DriveScans
from slam.recognition.location import LOST, STATED, locate
from slam.recognition.scanned_map import ScannedDrive, ScannedMap
from slam.recognition.self_similarity import SAMPLED_SUBMAPS, SelfSimilarity

from .test_drive_scans import known, mapped


class Building:
    """Map of a simulated drive, and its last metres as a drive that is searched for."""

    def __init__(self, world: str, seconds: float, metres: float) -> None:
        self.state: SlamState = mapped(world, 1, 0.0, seconds)[0]
        self.map: ScannedMap = known(self.state)
        travelled = self.state.mapper.travelled
        first = int(np.searchsorted(travelled, travelled[-1] - metres))
        self.drive: ScannedDrive = DriveScans().take(self.state.mapper, self.state.local_field, first)

    def similarity(self, share: float = 1.0) -> float:
        """Return the similarity of the map of the first keyframes, a share of all."""
        chosen = np.arange(self.state.mapper.keyframe_count) < share * self.state.mapper.keyframe_count
        return SelfSimilarity(self.state.mapper, self.state.local_field, chosen, self.map).of(self.drive)


@pytest.fixture(scope="module")
def office() -> Building:
    return Building("office", 30.0, 4.0)


def test_places_of_an_office_look_alike_less_than_a_decision_requires(office: Building) -> None:
    assert office.similarity() < LOST.required


def test_places_of_a_corridor_with_equal_doors_look_alike_more_than_that() -> None:
    assert Building("equal_doors", 60.0, 4.0).similarity() > 2.0 * LOST.required


def test_a_length_is_searched_for_once(office: Building, monkeypatch: pytest.MonkeyPatch) -> None:
    searched: list[ScannedDrive] = []
    monkeypatch.setattr(self_similarity, "_evidence_elsewhere", lambda stretch, _: float(searched.append(stretch) or 1))
    found: dict[int, float] = {}
    state, chosen = office.state, np.ones(office.state.mapper.keyframe_count, dtype=bool)
    for _ in range(2):
        similarity = SelfSimilarity(state.mapper, state.local_field, chosen, office.map, found)
        assert similarity.of(office.drive) == pytest.approx(1.0)
    assert len(searched) == SAMPLED_SUBMAPS
    assert len(found) == 1


def test_a_map_that_is_shorter_than_the_drive_says_nothing(office: Building) -> None:
    assert office.similarity(0.2) == -math.inf


def test_a_match_is_refused_if_places_of_the_map_look_as_much_alike(office: Building) -> None:
    alone = locate(office.drive, office.map, LOST)
    assert alone.accepted
    unlike = locate(office.drive, office.map, LOST, similarity=lambda _: -math.inf)
    assert unlike.evidence == alone.evidence
    alike = locate(office.drive, office.map, LOST, similarity=lambda _: alone.support + 10.0)
    assert alike.evidence < 0.0
    assert not alike.accepted
    assert "places of the map look as much alike" in alike.reason


def test_places_that_look_alike_do_not_count_if_the_drive_is_said_to_be_in_the_map(office: Building) -> None:
    assert locate(office.drive, office.map, STATED, similarity=lambda _: 1e3).accepted
