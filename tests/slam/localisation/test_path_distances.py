"""Ways between keyframes: which are near along the drive and links, and how passes through one place divide."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pytest

from slam.localisation.path_distances import MAX_PATH, PathDistances

STEP = 0.5  # metres between keyframes


def path_distances(
    count: int, links: Sequence[tuple[int, int]] = (), gaps: Mapping[int, float] | None = None
) -> PathDistances:
    """Return the path distances of an even drive."""
    return PathDistances.along([STEP * k for k in range(count)], gaps or {}, links)


def test_keyframes_are_near_along_the_drive_and_links() -> None:
    assert path_distances(200).near([100]).tolist() == list(range(61, 140))
    near = set(path_distances(200, [(20, 100)]).near([100]).tolist())
    assert near == {*range(61, 140), *range(60)}
    assert set(path_distances(200).near([0, 199]).tolist()) == {*range(40), *range(160, 200)}


def test_keyframes_belong_to_the_nearer_end_of_the_drive_except_through_links() -> None:
    assert path_distances(200).are_nearer([20], [120]).tolist() == [k < 70 for k in range(200)]
    linked = path_distances(200, [(20, 90)]).are_nearer([20], [120])
    assert linked.tolist() == [k < 105 for k in range(200)]


def test_what_is_undetermined_of_the_drive_counts_as_a_longer_way() -> None:
    assert path_distances(200, gaps={120: MAX_PATH}).near([100]).tolist() == list(range(61, 120))
    assert path_distances(200, gaps={120: 0.5 * MAX_PATH}).near([100]).tolist() == list(range(61, 120))
    assert path_distances(200, gaps={110: 0.5 * MAX_PATH}).near([100]).tolist() == list(range(61, 120))


@pytest.mark.parametrize(
    ("links", "groups"),
    [
        ([], [[0, 1, 2], [100, 101], [190]]),
        ([(2, 100)], [[0, 1, 2, 100, 101], [190]]),
        ([(20, 120)], [[0, 1, 2, 100, 101], [190]]),  # 9 m and 9.5 m from there
        ([(30, 130)], [[0, 1, 2], [100, 101], [190]]),  # farther
        ([(10, 180)], [[0, 1, 2, 190], [100, 101]]),
        ([(10, 180), (10, 110)], [[0, 1, 2, 100, 101, 190]]),
    ],
)
def test_passes_through_a_place_are_apart_unless_links_join_them(
    links: Sequence[tuple[int, int]], groups: list[list[int]]
) -> None:
    passes = [0, 1, 2, 100, 101, 190]
    assert [group.tolist() for group in path_distances(200, links).divide(passes)] == groups


def test_keyframes_of_one_pass_are_together_and_none_divide_into_nothing() -> None:
    assert [group.tolist() for group in path_distances(200).divide([10, 49, 88])] == [[10, 49, 88]]
    assert path_distances(200).divide([]) == []
