"""`wclm measure` on a simulated drive around a box in a room."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from slam.io.output_dir import SESSION
from slam.io.run_results import read_run_results
from slam.io.wall_maps import read_wall_map

WIDTH, DEPTH, BOX = 6.4, 4.2, (1.2, 0.7)
SIGMAS = 4.0
"""Standard deviations within which measurements of one drive must be."""


@pytest.fixture(scope="module")
def mapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("measured")


@pytest.fixture
def session(wclm: Any, mapped: Path, tmp_path: Path) -> Path:
    """Copy of the output directory of the drive, which is mapped once."""
    if not (mapped / "out").exists():
        result = wclm("run", "sim:room?seed=1", "--out", mapped / "out", "--no-review")
        assert result.exit_code == 0, result.output
    return Path(shutil.copytree(mapped / "out", tmp_path / "out"))


def table(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(text.splitlines()))


def test_a_room_has_its_true_dimensions_within_the_stated_deviations(wclm: Any, session: Path) -> None:
    result = wclm("measure", session, "--format", "csv")
    assert result.exit_code == 0, result.output
    rows = table(result.stdout)
    room = [row for row in rows if row["room"] == "1"]
    truths = {
        "area": [WIDTH * DEPTH - BOX[0] * BOX[1]],
        "perimeter": [2 * (WIDTH + DEPTH)],
        "length": [WIDTH, DEPTH],
        "angle": [np.pi / 2],
    }
    assert [row["kind"] for row in room].count("length") == 4
    for row in room:
        value, sigma = float(row["value"]), float(row["sigma"])
        assert 0.0 < sigma < 0.05
        assert min(abs(value - truth) for truth in truths[row["kind"]]) < SIGMAS * sigma
    sides = [row for row in rows if row["kind"] == "length" and not row["room"]]  # of the box
    assert all(min(abs(float(row["value"]) - side) for side in BOX) < SIGMAS * float(row["sigma"]) for row in sides)


def test_marginals_of_the_joint_covariance_are_those_of_the_map(session: Path) -> None:
    wall_map, walls = read_wall_map(session), read_run_results(session).walls
    np.testing.assert_array_equal(wall_map.walls.identity, walls.identity)
    count = np.arange(len(walls))
    blocks = wall_map.covariance.reshape(len(walls), 2, len(walls), 2)[count, :, count, :]
    np.testing.assert_allclose(blocks, walls.covariance, rtol=0.02, atol=1e-12)
    assert np.linalg.eigvalsh(wall_map.covariance).min() > -1e-12


def test_named_walls_are_measured(wclm: Any, session: Path) -> None:
    facing = next(row for row in table(wclm("measure", session, "--format", "csv").stdout) if row["kind"] == "width")
    first, second = facing["walls"].split()
    lines = wclm("measure", session, first, second).stdout.splitlines()
    assert any(line.startswith(f"distance between walls {first} and {second}: ") and "±" in line for line in lines)
    assert any(line.startswith(f"angle between walls {first} and {second}: ") for line in lines)


def test_drawings_have_a_dimension_for_each_side_of_the_room(wclm: Any, session: Path) -> None:
    import ezdxf

    for form in ("svg", "dxf"):
        result = wclm("measure", session, "--format", form)
        assert result.exit_code == 0, result.output
        assert ": 1 room, " in result.stdout
    root = ElementTree.parse(session / "measurements.svg").getroot()
    group = next(child for child in root if child.attrib.get("class") == "dimensions")
    texts = [element.text or "" for element in group if element.tag.endswith("text")]
    lengths = [float(text.split()[0]) for text in texts if "±" in text and text[0].isdigit()]
    assert sum(abs(length - WIDTH) < 0.005 for length in lengths) >= 2
    area = next(float(text.split()[2]) for text in texts if text.endswith("m²"))
    assert area == pytest.approx(WIDTH * DEPTH - BOX[0] * BOX[1], abs=0.1)
    document = ezdxf.readfile(session / "measurements.dxf")
    audit = document.audit()
    assert not [*audit.errors, *audit.fixes]
    dimensions = document.modelspace().query("DIMENSION")
    assert len(dimensions) == sum("m²" not in text for text in texts)
    longest = max(dimensions, key=lambda one: one.get_measurement())
    assert longest.get_measurement() == pytest.approx(WIDTH, abs=0.05)


def test_rooms_are_polygons_in_geojson(wclm: Any, session: Path) -> None:
    assert wclm("measure", session, "--format", "geojson").exit_code == 0
    features = json.loads((session / "measurements.geojson").read_text())["features"]
    (found,) = (feature for feature in features if feature["properties"]["kind"] == "room")
    assert found["properties"]["area"] == pytest.approx(WIDTH * DEPTH - BOX[0] * BOX[1], abs=0.1)


def test_mistakes_are_one_line(wclm: Any, session: Path) -> None:
    wclm.refuses("measure", session, 4000, because=["no wall 4000"])
    wclm.refuses("measure", session, "--format", "svg", "--out", "a.dxf", because=["a.dxf", ".svg"])
    shutil.rmtree(session / SESSION)
    wclm.refuses("measure", session, because=[str(session), "session"])
    wclm.refuses("measure", "nowhere", because=["nowhere", "no such directory"])


def test_a_regular_room_has_right_angles_and_its_true_dimensions(wclm: Any, session: Path) -> None:
    result = wclm("measure", session, "--regular", "--format", "csv")
    assert result.exit_code == 0, result.output
    assert "parallel or at right angles" in result.stderr
    room = [row for row in table(result.stdout) if row["room"] == "1"]
    angles = [float(row["value"]) for row in room if row["kind"] == "angle"]
    np.testing.assert_allclose(angles, np.pi / 2, atol=1e-5)
    for row in room:
        if row["kind"] == "length":
            error = min(abs(float(row["value"]) - truth) for truth in (WIDTH, DEPTH))
            assert error < SIGMAS * float(row["sigma"])
    assert wclm("map", session, "--regular", "--format", "svg", "--out", "regular.svg").exit_code == 0
    assert ElementTree.parse("regular.svg").getroot() is not None
    wclm.refuses("map", session, "--regular", "--format", "pgm", because=["is for geojson, svg and dxf"])


@pytest.mark.parametrize(("form", "suffix"), [("text", "txt"), pytest.param("csv", "csv", marks=pytest.mark.slow)])
def test_a_file_has_what_would_be_printed(wclm: Any, session: Path, tmp_path: Path, form: str, suffix: str) -> None:
    file = tmp_path / f"a.{suffix}"
    assert wclm("measure", session, "--format", form, "--out", file).exit_code == 0
    assert file.read_text() == wclm("measure", session, "--format", form).stdout
    problem = f"a.pdf: the name must end with .{suffix} for --format {form}"
    wclm.refuses("measure", session, "--format", form, "--out", "a.pdf", because=[problem])
