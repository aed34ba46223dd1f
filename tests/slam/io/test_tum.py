from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import se2
from slam.errors import MapError
from slam.io.tum import Trajectory, read_tum, write_tum

HEADING = st.floats(-np.pi, np.pi - 1e-6)
METRES = st.floats(-1e4, 1e4)


def test_trajectory_is_read_back_as_written(tmp_path: Path) -> None:
    generator = np.random.default_rng(1)
    stamps = 976052857.338278 + np.cumsum(generator.uniform(0.01, 0.2, 200))
    poses = generator.uniform([-50, -50, -np.pi], [50, 50, np.pi], (200, 3))
    write_tum(tmp_path / "a.tum", Trajectory(stamps, poses))
    back = read_tum(tmp_path / "a.tum")
    np.testing.assert_allclose(back.stamps, stamps, rtol=0, atol=1e-6)
    np.testing.assert_allclose(back.poses, poses, rtol=0, atol=1e-6)


@given(x=METRES, y=METRES, heading=HEADING)
def test_poses_are_read_back_to_half_a_micrometre_and_3_nanoradians(
    tmp_path_factory: pytest.TempPathFactory, x: float, y: float, heading: float
) -> None:
    file = tmp_path_factory.mktemp("tum") / "a.tum"
    write_tum(file, Trajectory(np.array([1.5]), np.array([[x, y, heading]])))
    pose = read_tum(file).poses[0]
    np.testing.assert_allclose(pose[:2], [x, y], rtol=0, atol=0.51e-6)
    assert abs(se2.wrap(pose[2] - heading)) < 3e-9


def test_line_has_eight_columns_and_no_negative_zero(tmp_path: Path) -> None:
    write_tum(tmp_path / "a.tum", Trajectory(np.array([12.25]), np.array([[-1e-9, 2.0, -1e-12]])))
    assert (tmp_path / "a.tum").read_text() == "12.250000 0.000000 2.000000 0.000000 0 0 0.000000000 1.000000000\n"


def test_comments_and_empty_lines_are_skipped_and_poses_sorted(tmp_path: Path) -> None:
    (tmp_path / "a.tum").write_text("# a comment\n\n2 1 0 0 0 0 0 1  # later\n1 0 0 0 0 0 1 0\n")
    trajectory = read_tum(tmp_path / "a.tum")
    np.testing.assert_array_equal(trajectory.stamps, [1.0, 2.0])
    np.testing.assert_allclose(trajectory.poses, [[0, 0, -np.pi], [1, 0, 0]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "a.tum: has no line of 8 numbers"),
        ("1 0 0 0 0 0 0 1\n2 0 0 0\n", "a.tum:2: expected 8 numbers (t x y z qx qy qz qw), found 4"),
        ("1 0 0 zero 0 0 0 1\n", "a.tum:1: expected 8 numbers (t x y z qx qy qz qw): could not convert"),
        ("# c\n1 0 nan 0 0 0 0 1\n", "a.tum:2: not all values are finite"),
        ("1 0 0 0 0 0 0 1\n2 0 -1e25 0 0 0 0 1\n", "a.tum:2: the position is beyond 1e+10 m"),
        ("1 0 0 0 0 0 0 2\n", "a.tum:1: the quaternion's length is 2, not 1"),
    ],
)
def test_file_and_line_of_an_error_are_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "a.tum").write_text(text)
    with pytest.raises(MapError) as caught:
        read_tum(tmp_path / "a.tum")
    assert message in str(caught.value)


def test_missing_or_binary_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"a\.tum: No such file"):
        read_tum(tmp_path / "a.tum")
    (tmp_path / "a.tum").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(MapError, match=r"a\.tum: is not a text file; expected lines of t x y z qx qy qz qw"):
        read_tum(tmp_path / "a.tum")


@pytest.mark.parametrize(
    ("stamps", "poses", "message"),
    [
        ([], np.zeros((0, 3)), "no pose"),
        ([1.0], np.zeros((2, 3)), "as many poses"),
        ([1.0], np.array([[0, 0, np.inf]]), "not finite"),
        ([2.0, 1.0], np.zeros((2, 3)), "decrease"),
    ],
)
def test_invalid_trajectory_is_refused(stamps: list[float], poses: np.ndarray, message: str) -> None:
    with pytest.raises(MapError, match=message):
        Trajectory(np.array(stamps), poses)


def test_poses_between_stamps_are_interpolated_by_the_shorter_turn() -> None:
    trajectory = Trajectory(np.array([0.0, 1.0, 2.0]), np.array([[0, 0, 3.0], [1, 0, -3.0], [1, 2, -3.0]]))
    found = trajectory.at([1.0004, 0.5, 1.75, -0.5, 2.5])
    np.testing.assert_array_equal(found.exact, [True, False, False, False, False])
    np.testing.assert_array_equal(found.covered, [True, True, True, False, False])
    np.testing.assert_allclose(found.poses[:, :2], [[1, 0], [0.5, 0], [1, 1.5], [0, 0], [1, 2]])
    np.testing.assert_allclose(np.cos(found.poses[1, 2]), -1)


def test_trajectory_of_one_pose_can_be_interpolated() -> None:
    found = Trajectory(np.array([5.0]), np.array([[1.0, 2.0, 3.0]])).at([5.0, 6.0])
    np.testing.assert_array_equal(found.exact, [True, False])
    np.testing.assert_allclose(found.poses, [[1, 2, 3]] * 2)


def test_travelled_distance_is_the_sum_of_steps() -> None:
    trajectory = Trajectory(np.arange(3.0), np.array([[0, 0, 0], [3, 4, 0], [3, 5, 0]], float))
    assert trajectory.length == pytest.approx(6.0)
    assert trajectory.duration == 2.0
