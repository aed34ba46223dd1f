"""The map of a drive from which scans can be left out: what is at rest, seen from its own side, and nothing else."""

from __future__ import annotations

import numpy as np

from slam.checks.leave_out_map import LeaveOutMap

ORIGIN = np.zeros(3)
ALONG = np.linspace(-1.0, 1.0, 101)


def wall(x: float, facing: float = -1.0) -> np.ndarray:
    """Return the points (p, 6) of a wall across x that faces along x."""
    points = np.zeros((len(ALONG), 6))
    points[:, 0], points[:, 1], points[:, 2] = x, ALONG, facing
    return points


def scaled(points: np.ndarray, share: float) -> np.ndarray:
    """Return points (p, 6) at a share of their distances, in the same beams."""
    return points * np.array([share, share, 1.0, 1.0, 1.0, 1.0])


def seen(*scans: np.ndarray) -> LeaveOutMap:
    """Return the map of scans from the origin."""
    others = LeaveOutMap(np.zeros((1, 2)))
    for scan in scans:
        others.add(scan, ORIGIN)
    return others


def likelihoods(others: LeaveOutMap, points: np.ndarray, pose: np.ndarray = ORIGIN) -> np.ndarray:
    return others.around(np.zeros(2), 10.0).likelihoods(points, pose)


def test_a_wall_that_was_seen_is_likely_and_unseen_space_says_nothing() -> None:
    others = seen(wall(4.03))
    assert (likelihoods(others, wall(4.03)) == 1.0).all()
    assert np.isnan(likelihoods(others, wall(4.03), np.array([-2.0, 5.0, 0.0]))).all()


def test_points_in_free_space_and_behind_a_wall_are_unlikely() -> None:
    others = seen(wall(4.03))
    for share in (0.8, 1.2):
        assert (likelihoods(others, scaled(wall(4.03)[20:-20], share)) == 0.0).all()


def test_likelihood_falls_with_the_distance() -> None:
    others, middle = seen(wall(4.03)), wall(4.03)[20:-20]
    near, farther = (likelihoods(others, middle, np.array([shift, 0.0, 0.0])) for shift in (0.1, 0.2))
    assert (near < 1.0).all()
    assert (near > farther).all()
    assert (farther > 0.0).all()


def test_what_more_beams_pass_than_end_at_is_not_at_rest() -> None:
    person = scaled(wall(4.03), 0.5)
    inner = person[30:-30]
    standing, walking = [person, person, wall(4.03)], [person, *3 * [wall(4.03)]]
    assert (likelihoods(seen(*standing), inner) == 1.0).all()
    assert (likelihoods(seen(*walking), inner) == 0.0).all()


def test_the_other_face_of_a_wall_is_another_surface() -> None:
    others = seen(wall(4.03))
    assert not (likelihoods(others, wall(4.03, facing=1.0)) > 0.0).any()
    without_normals = wall(4.03, facing=0.0)
    assert (likelihoods(others, without_normals) == 1.0).all()


def test_a_scan_that_is_left_out_leaves_no_trace() -> None:
    others, pose = seen(wall(4.03)), np.array([1.0, 2.0, 0.7])
    before = likelihoods(others, wall(4.03))
    others.add(wall(2.5), pose)
    others.leave_out(wall(2.5), pose)
    assert (likelihoods(others, wall(4.03)) == before).all()
    assert np.isnan(likelihoods(others, wall(2.5), pose)).any()


def test_gains_count_points_that_the_map_can_judge_here_and_there() -> None:
    others = seen(wall(4.03))
    around, points = others.around(np.zeros(2), 10.0), wall(3.53)[15:-15]
    here = around.likelihoods(points, ORIGIN)
    there = np.array([[0.5, 0.0, 0.0], [0.0, 0.0, 0.0], [-2.0, 5.0, 0.0]])
    assert around.gains(points, here, there).tolist() == [1.0, 0.0, 0.0]


def test_a_large_area_has_larger_cells() -> None:
    others = LeaveOutMap(np.array([[0.0, 0.0], [3000.0, 3000.0]]))
    assert others.cell > 1.0
