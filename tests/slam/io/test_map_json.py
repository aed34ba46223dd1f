import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slam.errors import MapError
from slam.events import Finished
from slam.io.map_json import read_map, write_map


def written(path: Path, finished: Finished) -> dict[str, Any]:
    write_map(path, finished.walls, finished.corners)
    return json.loads(path.read_text())


def test_map_is_read_back_as_written(tmp_path: Path, finished: Finished) -> None:
    write_map(tmp_path / "map.json", finished.walls, finished.corners)
    back = read_map(tmp_path / "map.json")
    for ours, theirs in ((back.walls, finished.walls), (back.corners, finished.corners)):
        for field in fields(theirs):
            if field.name == "pieces":
                continue
            value, expected = getattr(ours, field.name), getattr(theirs, field.name)
            np.testing.assert_allclose(value, expected, atol=1e-9)
            assert value.dtype == expected.dtype
    for piece, expected in zip(back.walls.pieces, finished.walls.pieces, strict=True):
        np.testing.assert_allclose(piece, expected, atol=1e-9)


def test_map_of_version_1_is_read(tmp_path: Path, finished: Finished) -> None:
    data = written(tmp_path / "map.json", finished)
    data["version"] = 1
    for line in data["lines"]:
        del line["pieces"]
    (tmp_path / "map.json").write_text(json.dumps(data))
    lines = read_map(tmp_path / "map.json").walls
    np.testing.assert_allclose(np.concatenate(lines.pieces), np.column_stack([lines.low, lines.high]))


def test_empty_map_is_read_back(tmp_path: Path, finished: Finished) -> None:
    none = slice(0, 0)
    lines = replace(finished.walls, **{f.name: getattr(finished.walls, f.name)[none] for f in fields(finished.walls)})
    empty = {f.name: getattr(finished.corners, f.name)[none] for f in fields(finished.corners)}
    write_map(tmp_path / "map.json", lines, replace(finished.corners, **empty))
    back = read_map(tmp_path / "map.json")
    assert len(back.walls) == len(back.corners) == 0
    assert back.walls.end_points().shape == (0, 2, 2)
    assert back.corners.covariance.shape == (0, 2, 2)


def test_file_states_format_version_and_units_and_has_no_nan(tmp_path: Path, finished: Finished) -> None:
    data = written(tmp_path / "map.json", finished)
    assert (data["format"], data["version"], data["frame"]) == ("wclm-slam map", 2, "map")
    assert data["units"] == {"length": "m", "angle": "rad"}
    wall = data["lines"][1]
    assert wall["identity"] == 1
    np.testing.assert_allclose([wall["start"], wall["end"]], [[6, 0], [6, 4]], atol=1e-9)
    assert data["lines"][3]["covariance"] is None
    assert "NaN" not in (tmp_path / "map.json").read_text()


def test_equal_maps_give_equal_bytes(tmp_path: Path, finished: Finished) -> None:
    for name in ("a.json", "b.json"):
        write_map(tmp_path / name, finished.walls, finished.corners)
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


def test_a_map_is_written_whatever_its_values_are_and_the_reader_names_the_invalid_one(
    tmp_path: Path, finished: Finished
) -> None:
    finished.walls.frame[2, 0] = np.nan
    assert written(tmp_path / "map.json", finished)["lines"][2]["frame"][1:] == [4.0, pytest.approx(np.pi)]
    with pytest.raises(MapError, match=r"map\.json: lines\.2\.frame\.0: input should be a valid number"):
        read_map(tmp_path / "map.json")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": 3}, "has format version 3; this program reads versions 1 and 2"),
        ({"version": None}, "has format version None"),
        ({"format": "another"}, 'its format is not "wclm-slam map"'),
        ({"lines": 3}, "lines: input should be a valid list"),
        ({"walls": []}, "walls: extra inputs are not permitted"),
        ({"units": {"length": "ft"}}, "units.length: input should be 'm'"),
    ],
)
def test_another_format_or_version_is_refused(
    tmp_path: Path, finished: Finished, change: dict[str, Any], message: str
) -> None:
    file = tmp_path / "map.json"
    file.write_text(json.dumps(written(file, finished) | change))
    with pytest.raises(MapError) as caught:
        read_map(file)
    assert str(file) in str(caught.value)
    assert message in str(caught.value)


def test_key_of_an_invalid_value_is_named(tmp_path: Path, finished: Finished) -> None:
    data = written(tmp_path / "map.json", finished)
    data["corners"][1]["position"][0] = "left"
    (tmp_path / "map.json").write_text(json.dumps(data))
    with pytest.raises(MapError, match=r"map\.json: corners\.1\.position\.0: input should be a valid number"):
        read_map(tmp_path / "map.json")


@pytest.mark.parametrize("identity", [-1, 10**25])
def test_an_identity_that_no_landmark_has_is_refused(tmp_path: Path, finished: Finished, identity: int) -> None:
    data = written(tmp_path / "map.json", finished)
    data["lines"][1]["identity"] = identity
    (tmp_path / "map.json").write_text(json.dumps(data))
    with pytest.raises(MapError, match=r"map.json: lines.1.identity: [iI]nput should be"):
        read_map(tmp_path / "map.json")


@pytest.mark.parametrize("end", [1e15, -1e15])
def test_a_wall_longer_than_any_building_is_refused(tmp_path: Path, finished: Finished, end: float) -> None:
    data = written(tmp_path / "map.json", finished)
    data["lines"][1]["pieces"] = [[0.0, end]]
    (tmp_path / "map.json").write_text(json.dumps(data))
    with pytest.raises(MapError, match=r"map.json: lines.1.pieces.0.1: input should be"):
        read_map(tmp_path / "map.json")


@pytest.mark.parametrize("content", [b"", b"{", b"[1, 2]", b"\xff\xfe", b"null"])
def test_file_that_is_not_a_map_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "map.json").write_bytes(content)
    with pytest.raises(MapError, match=r"map\.json: is not"):
        read_map(tmp_path / "map.json")


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"map\.json: No such file"):
        read_map(tmp_path / "map.json")
