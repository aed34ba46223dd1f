"""World files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers import RecordingError
from drivers.simulation import World, load_world

PATH = "path = [[0, 0], [1, 0]]\n"


def world(folder: Path, text: str) -> World:
    file = folder / "here.toml"
    file.write_text(text)
    return load_world(file)


def test_thin_wall_is_one_segment(tmp_path: Path) -> None:
    assert world(tmp_path, PATH + "[[walls]]\nfrom = [0, 1]\nto = [4, 1]\n").segments.tolist() == [[0, 1, 4, 1]]


def test_door_splits_a_wall_in_two(tmp_path: Path) -> None:
    segments = world(tmp_path, PATH + "[[walls]]\nfrom = [0, 1]\nto = [4, 1]\ndoors = [[1, 0.9]]\n").segments
    assert segments == pytest.approx(np.array([[0, 1, 1, 1], [1.9, 1, 4, 1]]))


def test_thick_wall_has_two_faces_and_jambs(tmp_path: Path) -> None:
    text = PATH + "[[walls]]\nfrom = [0, 1]\nto = [4, 1]\nthickness = 0.2\ndoors = [[1, 0.9]]\n"
    segments = world(tmp_path, text).segments
    assert segments.shape == (8, 4)
    assert set(np.round(segments[:, [1, 3]].ravel(), 9)) == {0.9, 1.1}
    assert set(np.round(segments[:, [0, 2]].ravel(), 9)) == {-0.1, 1.0, 1.9, 4.1}


def test_boxes_and_columns_are_read(tmp_path: Path) -> None:
    text = PATH + "[[boxes]]\nat = [2, 3]\nsize = [2, 1]\nturn = 90\n[[columns]]\nat = [5, 5]\nradius = 0.3\n"
    here = world(tmp_path, text)
    assert here.segments[:, [0, 2]].min() == pytest.approx(1.5)
    assert here.segments[:, [1, 3]].max() == pytest.approx(4.0)
    assert here.circles.tolist() == [[5, 5, 0.3]]
    assert here.name == "here"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "path"),
        ("path = [[0, 0]]", "path"),
        (PATH, "no walls"),
        ("not toml", "not a valid world file"),
        (PATH + "wals = []", "wals"),
        (PATH + "[[walls]]\nfrom = [0, nan]\nto = [1, 1]", "walls.0"),
        (PATH + "[[columns]]\nat = [0, 0]\nradius = -1", "radius"),
    ],
)
def test_invalid_files_are_one_line_errors(tmp_path: Path, text: str, reason: str) -> None:
    with pytest.raises(RecordingError, match=reason) as caught:
        world(tmp_path, text)
    assert "\n" not in str(caught.value)


def test_an_unknown_world_name_is_an_error() -> None:
    with pytest.raises(RecordingError, match=r"choose one of .*office"):
        load_world("atlantis")


def test_temporary_shapes_exist_from_since_to_until(tmp_path: Path) -> None:
    text = PATH + (
        "[[walls]]\nfrom = [0, 1]\nto = [4, 1]\n"
        "[[boxes]]\nat = [2, 3]\nsize = [2, 1]\nuntil = 5\n"
        "[[columns]]\nat = [5, 5]\nradius = 0.3\nsince = 5\nuntil = 9\n"
    )
    here = world(tmp_path, text)
    assert [(len(segments), len(circles)) for segments, circles in map(here.shapes_at, (0.0, 4.9, 5.0, 9.0))] == [
        (5, 0), (5, 0), (1, 1), (1, 0),
    ]  # fmt: skip
    assert here.segments.tolist() == [[0, 1, 4, 1]]
