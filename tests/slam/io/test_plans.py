"""Plans: drawings and grid maps of other programs, and the program's own exports, as walls in metres."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from slam.config import Config
from slam.errors import MapError
from slam.events import Finished
from slam.io.exports import write_dxf, write_geojson, write_pgm, write_pgm_yaml, write_svg
from slam.io.exports.occupancy import Occupancy
from slam.io.plans.reader import read_plan
from slam.io.plans.units import Unit
from slam.io.run_results import RunResults, read_run_results, write_results
from slam.mapping.plan_map import PlanMap, build_plan_map

ROOM = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 4.0], [0.0, 4.0]])
BOX = np.array([[2.0, 1.5], [3.5, 1.5], [3.5, 2.3], [2.0, 2.3]])
SIGMAS = (0.03, 0.005)


def sides(*outlines: np.ndarray) -> np.ndarray:
    return np.concatenate([np.stack([outline, np.roll(outline, -1, axis=0)], axis=1) for outline in outlines])


def assert_same_lines(found: np.ndarray, expected: np.ndarray, atol: float = 1e-6) -> None:
    """Assert that segments (n, 2, 2) are the same, in any order and direction."""
    assert len(found) == len(expected)
    for line in expected:
        distances = [np.abs(found - way).max(axis=(1, 2)).min() for way in (line, line[::-1])]
        assert min(distances) < atol


def write_drawing(path: Path, unit: float) -> Path:
    """Draw the room with the box in a format by its suffix, with `unit` units per metre; y points down in SVG."""
    room, box = unit * ROOM, unit * BOX
    if path.suffix == ".dxf":
        import ezdxf

        drawing = ezdxf.new()
        drawing.header["$INSUNITS"] = {1000.0: 4, 1.0: 0}[unit]
        drawing.modelspace().add_lwpolyline(room, close=True)
        block = drawing.blocks.new("BOX")
        block.add_polyline2d(box - box[0], close=True)
        drawing.modelspace().add_blockref("BOX", box[0])
        drawing.modelspace().add_circle((unit, unit), unit)
        drawing.saveas(path)
    elif path.suffix == ".svg":
        points = " ".join(f"{x},{-y}" for x, y in room)
        (x, y), (width, height) = box[0], box[2] - box[0]
        down = f'<path d="m{x} {-y}h{width}v{-height}H{x}z"/>'
        path.write_text(f'<svg xmlns="http://www.w3.org/2000/svg"><polygon points="{points}"/>{down}</svg>')
    else:
        rings = [[*room.tolist(), room[0].tolist()], [*box.tolist(), box[0].tolist()]]
        units = {} if unit == 1.0 else {"units": "mm"}
        path.write_text(json.dumps({"type": "Polygon", "coordinates": rings} | units))
    return path


@pytest.mark.parametrize("suffix", ["dxf", "svg", "geojson"])
def test_drawings_are_read_in_their_unit(tmp_path: Path, suffix: str) -> None:
    path = write_drawing(tmp_path / f"plan.{suffix}", 1000.0)
    plan = read_plan(path, Unit.MILLIMETRE if suffix == "svg" else None)
    assert_same_lines(plan.segments, sides(ROOM, BOX))
    assert plan.size == pytest.approx((6.0, 4.0))
    assert not plan.one_sided.any()


@pytest.mark.parametrize("suffix", ["dxf", "svg", "geojson"])
def test_a_drawing_without_a_unit_is_in_metres_and_says_so(tmp_path: Path, suffix: str) -> None:
    plan = read_plan(write_drawing(tmp_path / f"plan.{suffix}", 1.0))
    assert_same_lines(plan.segments, sides(ROOM, BOX))
    assert "6 m x 4 m" in plan.notes[0]
    assert "--plan-unit" in plan.notes[0]


def test_what_is_no_line_is_named(tmp_path: Path) -> None:
    plan = read_plan(write_drawing(tmp_path / "plan.dxf", 1000.0))
    assert plan.notes == ["left out, as they are no straight lines: 1 CIRCLE"]


def test_layers_of_a_drawing_can_be_chosen(tmp_path: Path) -> None:
    import ezdxf

    drawing = ezdxf.new()
    drawing.header["$INSUNITS"] = 6
    drawing.layers.add("Walls")
    drawing.modelspace().add_lwpolyline(ROOM, close=True, dxfattribs={"layer": "Walls"})
    drawing.modelspace().add_line((0, 0), (6, 4))
    drawing.saveas(tmp_path / "plan.dxf")
    assert len(read_plan(tmp_path / "plan.dxf").segments) == 5
    assert_same_lines(read_plan(tmp_path / "plan.dxf", layers=["walls"]).segments, sides(ROOM))
    with pytest.raises(MapError, match=r"plan\.dxf: has no layer doors; its layers are .*Walls"):
        read_plan(tmp_path / "plan.dxf", layers=["doors"])


def test_what_ezdxf_ignores_in_a_drawing_is_not_printed(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    import ezdxf

    drawing = ezdxf.new()
    drawing.modelspace().add_lwpolyline(ROOM, close=True)
    drawing.saveas(tmp_path / "plan.dxf")
    text = (tmp_path / "plan.dxf").read_text()
    layer = text.index("  0\nLAYER\n", text.index("AcDbSymbolTable\n", text.index("\nLAYER\n")))
    (tmp_path / "plan.dxf").write_text(text[:layer] + text[layer:].replace("LAYER", "ODD", 1))
    assert len(read_plan(tmp_path / "plan.dxf").segments) == len(ROOM)
    assert not caplog.records


def test_errors_of_damaged_drawings_are_short(tmp_path: Path) -> None:
    (tmp_path / "plan.dxf").write_text(f"0\nSECTION\n{'9' * 5000}\nx\n")
    with pytest.raises(MapError, match=r"plan\.dxf: is not a valid DXF file: ") as caught:
        read_plan(tmp_path / "plan.dxf")
    assert len(str(caught.value)) < 500


def test_a_drawing_of_too_many_lines_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_drawing(tmp_path / "room.svg", 1.0)
    monkeypatch.setattr("slam.io.plans.reader.MAX_LINES", 8)
    assert len(read_plan(path).segments) == 8
    monkeypatch.setattr("slam.io.plans.reader.MAX_LINES", 7)
    with pytest.raises(MapError, match=r"room.svg: has 8 lines, more than 7; export the walls alone, or .*-layer"):
        read_plan(path)


def test_an_outline_that_crosses_itself_has_the_walls_that_are_drawn(tmp_path: Path) -> None:
    crossing = np.array([[0.0, 0.0], [10.0, 8.0], [10.0, 0.0], [0.0, 8.0]])
    outline = [*crossing.tolist(), crossing[0].tolist()]
    (tmp_path / "a.json").write_text(json.dumps({"type": "Polygon", "coordinates": [outline]}))
    plan = read_plan(tmp_path / "a.json")
    assert_same_lines(plan.segments, sides(crossing))
    walls = build_plan_map(plan, SIGMAS).walls
    directions = np.arctan2(8.0, 10.0) * np.array([1.0, -1.0])
    diagonal = [(np.abs(np.sin(walls.frame[:, 2] - heading)) < 1e-9).sum() for heading in directions]
    assert diagonal == [2, 2]  # both sides of each are seen, and the other two lines from within


def test_transformations_of_svg_are_applied(tmp_path: Path) -> None:
    group = '<g transform="translate(1 -2) rotate(90)"><g transform="scale(2)">{}</g></g>'
    line = '<rect x="0" y="0" width="2" height="1"/><path d="M0 0C1 1 2 1 3 0L4 0"/>'
    (tmp_path / "a.svg").write_text(f"<svg>{group.format(line)}</svg>")
    plan = read_plan(tmp_path / "a.svg", Unit.METRE)
    rect = np.array([[1.0, 2.0], [1.0, -2.0], [-1.0, -2.0], [-1.0, 2.0]])
    assert_same_lines(plan.segments, np.concatenate([sides(rect), [[[1.0, -4.0], [1.0, -6.0]]]]))
    assert plan.notes == ["left out, as they are no straight lines: 1 curves of paths"]


@pytest.fixture
def results(tmp_path: Path, finished: Finished) -> RunResults:
    folder = tmp_path / "room"
    folder.mkdir()
    write_results(folder, finished, Config(), {"recording": "room.mcap"})
    return read_run_results(folder)


@pytest.mark.parametrize(("suffix", "write"), [("dxf", write_dxf), ("svg", write_svg), ("geojson", write_geojson)])
def test_exports_of_a_map_are_its_walls(results: RunResults, tmp_path: Path, suffix: str, write: Callable) -> None:
    write(tmp_path / f"a.{suffix}", results)
    plan = read_plan(tmp_path / f"a.{suffix}")
    np.testing.assert_allclose(plan.segments, results.walls.piece_points()[0], atol=6e-4)
    assert plan.one_sided.all()
    assert not plan.notes


def test_the_map_of_an_earlier_run_is_a_plan(results: RunResults) -> None:
    plan = read_plan(results.path)
    np.testing.assert_allclose(plan.segments, results.walls.piece_points()[0], atol=1e-6)
    assert plan.viewpoints is not None


def grid_map(path: Path, turn: float = 0.0, cell: float = 0.05) -> Path:
    """Write the grid map of the room with the box, turned by an angle; the outside is unknown."""
    axis = np.arange(-8.0, 8.0, cell) + 0.5 * cell
    x, y = np.meshgrid(axis, axis)
    c, s = np.cos(turn), np.sin(turn)
    u, v = c * x + s * y + 3.0, c * y - s * x + 2.0
    inside = (u > 0.0) & (u < 6.0) & (v > 0.0) & (v < 4.0)
    box = (u > 2.0) & (u < 3.5) & (v > 1.5) & (v < 2.3)
    near = (u > -cell) & (u < 6.0 + cell) & (v > -cell) & (v < 4.0 + cell)
    cells = np.where(inside & ~box, 0, np.where(near, 100, -1)).astype(np.int8)
    write_pgm(path, Occupancy(cells, np.array([-8.0, -8.0]), cell))
    write_pgm_yaml(path.with_suffix(".yaml"), Occupancy(cells, np.array([-8.0, -8.0]), cell), path.name)
    return path.with_suffix(".yaml")


@pytest.mark.parametrize("turn", [0.0, 0.3])
def test_walls_of_a_grid_map_are_found_within_a_cell(tmp_path: Path, turn: float) -> None:
    plan_map = build_plan_map(read_plan(grid_map(tmp_path / "map.pgm", turn)), SIGMAS)
    c, s = np.cos(turn), np.sin(turn)
    expected = (sides(ROOM, BOX[::-1]) - [3.0, 2.0]) @ np.array([[c, s], [-s, c]])
    assert_walls(plan_map, expected, offset=0.05, heading=0.02)


def test_a_thin_wall_that_beams_graze_is_one_wall(tmp_path: Path) -> None:
    """In grid maps of real drives, every other cell of a wall as thin as a cell, seen from both sides, is unknown."""
    cell, length = 0.05, 100
    cells = np.zeros((80, 120), dtype=np.int8)
    cells[[0, -1]] = cells[:, 0] = cells[:, -1] = 100
    cells[40, 10 : 10 + length] = np.where(np.arange(length) % 2, -1, 100)
    grid = Occupancy(cells, np.zeros(2), cell)
    write_pgm(tmp_path / "map.pgm", grid)
    write_pgm_yaml(tmp_path / "map.yaml", grid, "map.pgm")
    walls = build_plan_map(read_plan(tmp_path / "map.yaml"), SIGMAS).walls
    level = np.abs(np.sin(walls.frame[:, 2])) < 0.1
    inner = np.flatnonzero(level & (np.abs(walls.frame[:, 1] - 40.5 * cell) < cell))
    assert len(inner) == 2  # a side each
    for row in inner.tolist():
        assert np.ptp(walls.pieces[row], axis=1).sum() > 0.9 * length * cell


def test_cells_of_a_grid_map_may_be_tiny(tmp_path: Path) -> None:
    """The map is then too small for a robot, but it is a map."""
    path = grid_map(tmp_path / "map.pgm")
    (line,) = [line for line in path.read_text().splitlines() if line.startswith("resolution")]
    path.write_text(path.read_text().replace(line, "resolution: 1e-200"))
    assert len(read_plan(path).segments)


def test_pictures_of_a_grid_map_may_be_png(tmp_path: Path) -> None:
    path = grid_map(tmp_path / "map.pgm")
    with Image.open(tmp_path / "map.pgm") as picture:
        picture.save(tmp_path / "map.png")
    (tmp_path / "map.pgm").unlink()
    with pytest.raises(MapError, match=r"map\.pgm: No such file"):
        read_plan(path)
    path.write_text(path.read_text().replace("map.pgm", "map.png"))
    assert_same_lines(read_plan(tmp_path / "map.png").segments, read_plan(path).segments)
    assert len(build_plan_map(read_plan(path), SIGMAS).walls) == 8


def assert_walls(plan_map: PlanMap, expected: np.ndarray, offset: float, heading: float) -> None:
    """Assert that the walls are expected segments (n, 2, 2), seen from their left."""
    walls = plan_map.walls
    assert len(walls) == len(expected)
    for start, end in expected:
        along = end - start
        true = np.arctan2(along[1], along[0])
        normal = np.array([-np.sin(true), np.cos(true)])
        turned = np.abs((walls.frame[:, 2] - true + np.pi) % (2 * np.pi) - np.pi)
        across = np.abs((walls.frame[:, :2] - start) @ normal)
        (row,) = np.flatnonzero((turned < heading) & (across < offset))
        assert walls.high[row] - walls.low[row] == pytest.approx(np.hypot(*along), abs=0.3)


def test_only_sides_that_can_be_seen_become_walls(tmp_path: Path) -> None:
    thick = sides(ROOM, ROOM + 0.1 * np.sign(ROOM - [3.0, 2.0]), BOX)
    (tmp_path / "a.geojson").write_text(
        json.dumps({"type": "MultiLineString", "coordinates": thick.tolist(), "units": "m"})
    )
    assert_walls(build_plan_map(read_plan(tmp_path / "a.geojson"), SIGMAS), sides(ROOM, BOX[::-1]), 1e-6, 1e-6)


def test_pieces_of_one_wall_are_joined_across_a_door(tmp_path: Path) -> None:
    lines = [*sides(ROOM)[1:].tolist(), [[0, 0], [2, 0]], [[3, 0], [5, 0]], [[5, 0], [6, 0]]]
    (tmp_path / "a.geojson").write_text(json.dumps({"type": "MultiLineString", "coordinates": lines, "units": "m"}))
    walls = build_plan_map(read_plan(tmp_path / "a.geojson"), SIGMAS).walls
    assert len(walls) == 4
    (bottom,) = np.flatnonzero(np.abs(walls.frame[:, 2]) < 1e-9)
    np.testing.assert_allclose(walls.pieces[bottom] + walls.frame[bottom, 0], [[0, 2], [3, 6]], atol=0.25)
    millimetre, length = 1e-3, 6.0  # each end of a line in a drawing is rounded to millimetres
    expected = np.diag([0.03**2 + millimetre**2, 0.005**2 + 2.0 * (millimetre / length) ** 2])
    np.testing.assert_allclose(walls.covariance[bottom], expected, rtol=1e-6)


BAD_FILES = {
    "a.dxf": ("nonsense", "is not a"),
    "short.dxf": ("0\nSECTION\n", "is not a valid DXF file: StopIteration"),
    "a.svg": ("<svg><line", "is not XML"),
    "b.svg": ("<html/>", "is not SVG"),
    "c.svg": ('<svg><path d="M0 0 L5"/></svg>', "too few"),
    "d.svg": ("<svg><line x1='0' y1='x'/></svg>", "y1 is no number"),
    "a.geojson": ("{", "is not JSON"),
    "b.geojson": ('{"type": "LineString", "coordinates": [[0], [1, 2]]}', "wrong coordinates"),
    "c.geojson": ('{"type": "Point", "coordinates": [0, 0]}', "has no straight line"),
    "d.geojson": ('{"type": "LineString", "coordinates": [[0, 0], [9000, 2]]}', "--plan-unit"),
    "e.geojson": ('{"type": "LineString", "coordinates": [[0, 0], [9, NaN]]}', "not finite"),
    "features.geojson": ('{"type": "FeatureCollection", "features": true}', "has no straight line"),
    "units.geojson": ('{"type": "LineString", "coordinates": [], "units": ["m"]}', "none of m, cm, mm"),
    "f.geojson": ('{"type": "LineString", "coordinates": [], "units": "yd"}', "none of m, cm, mm"),
    "a.yaml": ("image: [", "is not valid YAML"),
    "b.yaml": ("image: a.pgm", "it has no resolution"),
    "c.yaml": ("image: none.pgm\nresolution: 0.05\norigin: [0, 0, 0]", "No such file"),
    "d.yaml": ("image: d.yaml\nresolution: 0.05\norigin: [0, 0, 0]", "is not a picture"),
    "e.yaml": ('image: "d.pgm\\nmode"\nresolution: 0.05\norigin: [0, 0, 0]', "image is no name of a file"),
    "f.yaml": ("image: 3\nresolution: 0.05\norigin: [0, 0, 0]", "image is no name of a file"),
    "a.pgm": ("P5 3 3 255 ", "needs a.yaml beside it"),
    "a.txt": ("", "is no plan"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_files_are_named_with_the_problem(tmp_path: Path, name: str) -> None:
    content, problem = BAD_FILES[name]
    (tmp_path / name).write_text(content)
    with pytest.raises(MapError) as raised:
        read_plan(tmp_path / name)
    assert str(raised.value).startswith(str(tmp_path))
    assert problem in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_picture_that_is_cut_off_is_refused(tmp_path: Path) -> None:
    path = grid_map(tmp_path / "map.pgm")
    (tmp_path / "map.pgm").write_bytes((tmp_path / "map.pgm").read_bytes()[:-1])
    with pytest.raises(MapError, match="is cut off"):
        read_plan(path)


def test_a_picture_with_absurd_sizes_is_refused(tmp_path: Path) -> None:
    path = grid_map(tmp_path / "map.pgm")
    (tmp_path / "map.pgm").write_bytes(b"P5 " + 5000 * b"1" + b" 3 255 ")
    with pytest.raises(MapError, match="not a valid PGM"):
        read_plan(path)
