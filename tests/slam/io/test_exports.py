"""Export formats, read back with independent readers."""

import json
import re
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from slam.config import Config
from slam.errors import MapError
from slam.events import Finished
from slam.io.exports import write_dxf, write_geojson, write_svg
from slam.io.exports.dimension_lines import TEXT_HEIGHT
from slam.io.exports.measurements_csv import measurements_csv
from slam.io.exports.text_placement import placed_dimensions
from slam.io.plans.geojson import read_geojson
from slam.io.plans.svg import read_svg
from slam.io.run_results import RunResults, read_run_results, write_results
from slam.io.tum import Trajectory
from slam.measuring.measured_map import MeasuredMap, measure_all

from ..measuring.plans import around, room, wall_map


@pytest.fixture
def results(tmp_path: Path, finished: Finished) -> RunResults:
    """Return the results of a run in a room in which one wall has two pieces."""
    folder = tmp_path / "room"
    folder.mkdir()
    write_results(folder, finished, Config(), {"recording": "room.mcap"})
    return read_run_results(folder)


def test_dxf_has_walls_as_lines_on_layers(results: RunResults, tmp_path: Path) -> None:
    import ezdxf

    write_dxf(tmp_path / "a.dxf", results)
    document = ezdxf.readfile(tmp_path / "a.dxf")
    audit = document.audit()
    assert not [*audit.errors, *audit.fixes]
    assert (document.dxfversion, document.header["$INSUNITS"], document.header["$MEASUREMENT"]) == ("AC1015", 6, 1)
    assert {layer.dxf.name for layer in document.layers} == {"0", "Defpoints", "WALLS", "CORNERS", "PATH"}
    space = document.modelspace()
    assert {(entity.dxftype(), entity.dxf.layer) for entity in space} == {
        ("LINE", "WALLS"),
        ("POINT", "CORNERS"),
        ("LWPOLYLINE", "PATH"),
    }
    walls = np.array([[line.dxf.start, line.dxf.end] for line in space.query("LINE")])[..., :2]
    np.testing.assert_allclose(walls, results.walls.piece_points()[0], atol=1e-6)
    assert len(walls) == 5  # four walls, one with a door
    corners = np.array([point.dxf.location for point in space.query("POINT")])[:, :2]
    np.testing.assert_allclose(corners, results.corners.position, atol=1e-6)
    (path,) = space.query("LWPOLYLINE")
    ends = np.array(path.get_points("xy"))[[0, -1]]
    np.testing.assert_allclose(ends, results.trajectory.poses[[0, -1], :2], atol=1e-6)
    low, high = np.array(document.header["$EXTMIN"])[:2], np.array(document.header["$EXTMAX"])[:2]
    assert (low <= walls.min(axis=(0, 1)) + 1e-6).all()
    assert (high >= walls.max(axis=(0, 1)) - 1e-6).all()


def test_dxf_is_the_same_if_written_twice(results: RunResults, tmp_path: Path) -> None:
    import ezdxf

    for name in ("a.dxf", "b.dxf"):
        write_dxf(tmp_path / name, results)
    assert (tmp_path / "a.dxf").read_bytes() == (tmp_path / "b.dxf").read_bytes()
    assert not ezdxf.options.write_fixed_meta_data_for_testing


@pytest.fixture
def measured() -> MeasuredMap:
    """Return the measurements, rooms and doors of a room with a pillar and a door, through which the robot came."""
    pillar = [(1.0, 2.0), (1.0, 3.0), (2.0, 3.0), (2.0, 2.0)]
    walls = [*room([(0.0, 0.0), (5.0, 0.0), (5.0, 4.0), (0.0, 4.0)]), *room(pillar)]
    walls[0] = [(0.0, 0.0), (2.0, 0.0), (3.0, 0.0), (5.0, 0.0)]
    return measure_all(wall_map(walls, [*around(4), *around(4, 4)], path=[(2.5, -2.0), (2.5, 1.5)]))


def test_dxf_has_rooms_doors_and_dimensions(results: RunResults, measured: MeasuredMap, tmp_path: Path) -> None:
    import ezdxf

    write_dxf(tmp_path / "a.dxf", results, measured)
    document = ezdxf.readfile(tmp_path / "a.dxf")
    audit = document.audit()
    assert not [*audit.errors, *audit.fixes]
    space = document.modelspace()
    outlines = [np.array(line.get_points("xy")) for line in space.query('LWPOLYLINE[layer=="ROOMS"]') if line.closed]
    assert [np.ptp(outline, axis=0).tolist() for outline in outlines] == [[5.0, 4.0], [1.0, 1.0]]
    (door,) = space.query('LINE[layer=="OPENINGS"]')
    assert sorted([door.dxf.start.x, door.dxf.end.x]) == pytest.approx([2.0, 3.0])
    texts = {text.dxf.layer: text.dxf.text for text in space.query("TEXT")}
    assert texts == {"ROOMS": "room 1: 19.00 ± 0.01 m²", "OPENINGS": "door 1: 1.0 m"}
    lines = placed_dimensions(measured)
    dimensions = list(space.query("DIMENSION"))
    assert len(dimensions) == len(lines) > 4
    for dimension, (line, place) in zip(dimensions, lines, strict=True):
        assert (dimension.dxf.layer, dimension.dxf.dimstyle) == ("DIMENSIONS", "METRES")
        assert dimension.dxf.text == line.text
        assert dimension.get_measurement() == pytest.approx(np.hypot(*(line.measured[1] - line.measured[0])), abs=1e-5)
        (text,) = (entity for entity in dimension.get_geometry_block() if entity.dxftype() == "MTEXT")
        below = np.array(text.dxf.insert)[:2] - place
        assert below @ [np.cos(line.angle), np.sin(line.angle)] == pytest.approx(0.0, abs=1e-5)
        assert 0.0 < below @ [-np.sin(line.angle), np.cos(line.angle)] < 2.0 * TEXT_HEIGHT
        assert -85.0 <= text.get_rotation() <= 95.0  # not upside down; read from the right if upright


def test_svg_has_rooms_without_their_islands_and_doors(
    results: RunResults, measured: MeasuredMap, tmp_path: Path
) -> None:
    write_svg(tmp_path / "a.svg", results, measured)
    root, space = ElementTree.parse(tmp_path / "a.svg").getroot(), {"s": "http://www.w3.org/2000/svg"}
    (area,) = root.findall("s:g[@class='rooms']/s:path", space)
    assert area.attrib["d"].count("M") == area.attrib["d"].count("Z") == 2
    assert area[0].text == "room 1: 94 % of the outline was seen"
    (door,) = root.findall("s:g[@class='openings']/s:text", space)
    assert door.text == "door 1: 1.0 m"


def test_geojson_has_rooms_and_doors(results: RunResults, measured: MeasuredMap, tmp_path: Path) -> None:
    write_geojson(tmp_path / "a.geojson", results, measured)
    features = json.loads((tmp_path / "a.geojson").read_text())["features"]
    found, door = features[-2:]
    outline, island = (np.array(ring) for ring in found["geometry"]["coordinates"])
    assert (found["properties"]["name"], found["properties"]["area"]) == ("room 1", 19.0)
    assert 0.0 < found["properties"]["sigma_area"] < 0.1
    for ring, turn in ((outline, 1.0), (island, -1.0)):  # counter-clockwise outline, clockwise hole, both closed
        assert ring[0].tolist() == ring[-1].tolist()
        x, y = ring.T
        assert np.sign(x[:-1] @ y[1:] - x[1:] @ y[:-1]) == turn
    assert door["geometry"]["type"] == "LineString"
    expected = {"kind": "door", "name": "door 1", "width": 1.0, "walls": [10], "rooms": [1], "driven": True}
    assert door["properties"] == expected


def test_geojson_has_pieces_of_walls_and_standard_deviations(results: RunResults, tmp_path: Path) -> None:
    write_geojson(tmp_path / "a.geojson", results)
    collection = json.loads((tmp_path / "a.geojson").read_text())
    assert (collection["type"], collection["frame"], collection["units"]) == ("FeatureCollection", "map", "m")
    kinds = defaultdict(list)
    for feature in collection["features"]:
        assert feature["type"] == "Feature"
        kinds[feature["properties"]["kind"]].append(feature)
    assert [len(kinds[kind]) for kind in ("wall", "corner", "path")] == [4, 2, 1]
    door = kinds["wall"][3]
    assert door["geometry"]["type"] == "MultiLineString"
    np.testing.assert_allclose(door["geometry"]["coordinates"], [[[0, 4], [0, 2.5]], [[0, 1.6], [0, 0]]], atol=1e-6)
    assert door["properties"]["identity"] == 7
    assert door["properties"]["sigma_offset"] is None
    assert kinds["wall"][0]["properties"]["sigma_offset"] == pytest.approx(np.sqrt(1e-5), rel=1e-2)
    assert kinds["corner"][0]["geometry"] == {"type": "Point", "coordinates": [6.0, 0.0]}
    assert len(kinds["path"][0]["geometry"]["coordinates"]) > 10


def test_svg_is_true_to_scale_with_y_up(results: RunResults, tmp_path: Path) -> None:
    write_svg(tmp_path / "a.svg", results)
    root = ElementTree.parse(tmp_path / "a.svg").getroot()
    space = {"s": "http://www.w3.org/2000/svg"}
    left, top, width, height = (float(word) for word in root.attrib["viewBox"].split())
    assert root.attrib["width"] == f"{10 * width:.1f}mm"
    assert float(root.attrib["height"].removesuffix("mm")) == pytest.approx(10 * height, abs=0.1)
    (bar,) = root.findall("s:g[@class='scale']", space)
    x, y, length = (float(word) for word in re.findall(r"M(.*),(.*)v.*h(.*)v", bar[0].attrib["d"])[0])
    assert bar[1].text == f"{length:g} m, 1 : 100"
    assert left < x < x + length < left + width
    assert 0.0 < y < float(bar[1].attrib["y"]) < top + height
    assert left < 0 < 6 < left + width
    assert top < -4 < 0 < y
    walls = root.findall("s:g[@class='walls']/s:path", space)
    assert walls[0].attrib["d"] == "M0.000,0.000L6.000,0.000"
    assert walls[3].attrib["d"].count("M") == 2
    assert "M6.000,-4.000" in walls[2].attrib["d"]
    assert "standard deviation 3.2 mm across" in walls[0][0].text
    assert "standard deviation" not in walls[3][0].text
    corners = root.findall("s:g[@class='corners']/s:ellipse", space)
    assert len(corners) == 1
    assert float(corners[0].attrib["rx"]) == pytest.approx(3 * np.sqrt(4.414e-5), abs=1e-4)


def test_svg_leaves_out_ellipses_that_would_cover_walls(results: RunResults, tmp_path: Path) -> None:
    """The corners of a part of the map that is not connected are uncertain by metres."""
    uncertain = replace(results.corners, covariance=results.corners.covariance.copy())
    uncertain.covariance[0] = 25.0 * np.eye(2)
    write_svg(tmp_path / "map.svg", replace(results, corners=uncertain))
    root, space = ElementTree.parse(tmp_path / "map.svg").getroot(), {"s": "http://www.w3.org/2000/svg"}
    assert not root.findall("s:g[@class='corners']/s:ellipse", space)
    assert len(root.findall("s:g[@class='corners']/s:path", space)) == len(uncertain)
    assert "standard deviation 5000.0 mm" in (tmp_path / "map.svg").read_text()


def test_the_table_has_doors_without_a_standard_deviation(measured: MeasuredMap) -> None:
    last = measurements_csv(measured).splitlines()[-1]
    assert last == "1,door,10,1.00,,m,2.0000,0.0000,3.0000,0.0000"


@pytest.fixture
def uncertain(tmp_path: Path, finished: Finished) -> RunResults:
    """Return the results of a run whose path becomes ever less certain, and one wall at one end."""
    covariance = finished.walls.covariance.copy()
    covariance[0] = [[1e-4, 2e-4], [2e-4, 4e-4]]  # standard deviation across |0.01 + 0.02 d| at d metres
    sigma = np.linspace(0.0, 0.2, len(finished.keyframes))
    run = replace(
        finished,
        walls=replace(finished.walls, covariance=covariance),
        keyframes=replace(finished.keyframes, covariance=np.eye(3) * np.square(sigma)[:, None, None]),
    )
    folder = tmp_path / "uncertain"
    folder.mkdir()
    write_results(folder, run, Config(), {"recording": "room.mcap"})
    return read_run_results(folder)


def test_geojson_has_the_confidence_of_walls_and_weak_places(uncertain: RunResults, tmp_path: Path) -> None:
    write_geojson(tmp_path / "a.geojson", uncertain)
    features = json.loads((tmp_path / "a.geojson").read_text())["features"]
    of_wall = [one for one in features if one["properties"]["kind"] == "confidence" and one["properties"]["wall"] == 0]
    ends = np.array([one["geometry"]["coordinates"] for one in of_wall])
    np.testing.assert_allclose(ends[1:, 0], ends[:-1, 1])  # the stretches make up the wall
    np.testing.assert_allclose([ends[0, 0], ends[-1, 1]], [[0, 0], [6, 0]], atol=1e-6)
    for one, (start, end) in zip(of_wall, ends, strict=True):
        sigma = max(abs(0.01 + 0.02 * (x - 3.0)) for x in (start[0], end[0]))
        assert one["properties"]["sigma"] == pytest.approx(sigma, rel=1e-2)
        assert sigma <= one["properties"]["under"]
    assert {one["properties"]["under"] for one in of_wall} == {0.02, 0.05, 0.1}
    assert not any(one["properties"].get("wall") == 7 for one in features)  # its covariance is unknown
    stretch, wall = (one for one in features if one["properties"]["kind"] == "weak_place")
    assert [weak["properties"]["of"] for weak in (stretch, wall)] == ["stretch", "wall"]
    assert stretch["properties"]["sigma"] == pytest.approx(0.2)
    assert wall["geometry"] == {"type": "Point", "coordinates": [0.0, 0.0]}  # the path beside the other end is as weak


def test_svg_has_the_confidence_map_in_groups_of_its_own(uncertain: RunResults, tmp_path: Path) -> None:
    write_svg(tmp_path / "a.svg", uncertain)
    root = ElementTree.parse(tmp_path / "a.svg").getroot()
    space = {"s": "http://www.w3.org/2000/svg"}
    bands = root.findall("s:g[@class='confidence']/s:path", space)
    assert {"p0", "p1", "p2"} <= {band.attrib["class"] for band in bands}
    assert "relative to the origin" in bands[0][0].text
    stretch, wall = root.findall("s:g[@class='weak']/s:circle", space)
    assert "known to 20 cm only" in stretch[0].text
    assert (wall.attrib["cx"], wall.attrib["cy"]) == ("0.000", "0.000")


@pytest.mark.parametrize("parts", [5, ["a"], [{"joined": False}], [{"keyframe": "x", "joined": False}]])
def test_damaged_parts_are_refused(uncertain: RunResults, tmp_path: Path, parts: object) -> None:
    damaged = replace(uncertain, summary={"slam": {"parts": parts}})
    with pytest.raises(MapError, match=r"summary\.json: slam\.parts"):
        write_geojson(tmp_path / "a.geojson", damaged)


def test_a_part_that_is_not_joined_is_a_weak_place(uncertain: RunResults, tmp_path: Path) -> None:
    parts = [{"keyframe": 0, "joined": True}, {"keyframe": 3, "joined": False}]
    write_geojson(tmp_path / "a.geojson", replace(uncertain, summary={"slam": {"parts": parts}}))
    features = json.loads((tmp_path / "a.geojson").read_text())["features"]
    (place,) = (one for one in features if one["properties"].get("of") == "part")
    assert uncertain.keyframes is not None
    np.testing.assert_allclose(place["geometry"]["coordinates"], uncertain.keyframes.poses[3, :2], atol=1e-6)


@pytest.mark.parametrize("suffix", [".svg", ".geojson"])
def test_the_confidence_map_is_no_wall_of_a_plan(uncertain: RunResults, tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"a{suffix}"
    {".svg": write_svg, ".geojson": write_geojson}[suffix](file, uncertain)
    lines = {".svg": read_svg, ".geojson": read_geojson}[suffix](file).lines
    assert sum(len(line) > 0 for line in lines) == sum(map(len, uncertain.walls.pieces))


def test_each_drive_of_a_map_has_a_path_of_its_own(results: RunResults, tmp_path: Path) -> None:
    ezdxf = pytest.importorskip("ezdxf")
    trajectory = results.trajectory
    later = trajectory.stamps + trajectory.duration + 1.0
    both = Trajectory(
        np.concatenate([trajectory.stamps, later]), np.concatenate([trajectory.poses, trajectory.poses + 50.0])
    )
    recordings = [{"first": stamps[0], "last": stamps[-1]} for stamps in (trajectory.stamps, later)]
    drives = replace(results, trajectory=both, summary={"recordings": recordings})
    write_dxf(tmp_path / "map.dxf", drives)
    paths = ezdxf.readfile(tmp_path / "map.dxf").modelspace().query('LWPOLYLINE[layer=="PATH"]')
    ends = [np.array([path[0][:2], path[-1][:2]]) for path in paths]
    write_geojson(tmp_path / "map.geojson", drives)
    features = json.loads((tmp_path / "map.geojson").read_text())["features"]
    lines = [one["geometry"]["coordinates"] for one in features if one["properties"]["kind"] == "path"]
    write_svg(tmp_path / "map.svg", drives)
    runs = re.findall(r'<polyline [^>]*points="([^"]*)"', (tmp_path / "map.svg").read_text())
    steps = [np.diff([[float(x) for x in point.split(",")] for point in run.split()], axis=0) for run in runs]
    assert max(np.abs(step).max() for step in steps if len(step)) < 5.0
    for k, moved in enumerate((0.0, 50.0)):
        expected = trajectory.poses[[0, -1], :2] + moved
        np.testing.assert_allclose(ends[k], expected, atol=1e-3)
        np.testing.assert_allclose([lines[k][0], lines[k][-1]], expected, atol=1e-3)
