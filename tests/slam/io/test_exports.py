"""Export formats, read back with independent readers, and errors of `wclm map`."""

import json
import re
import struct
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from slam.config import Config
from slam.errors import MapError
from slam.events import Finished
from slam.io.exports import write_dxf, write_geojson, write_svg
from slam.io.keyframes_csv import read_keyframes
from slam.io.output_dir import write_json, write_results
from slam.io.plans.geojson import read_geojson
from slam.io.plans.svg import read_svg
from slam.io.run_results import RunResults, read_run_results

FORMATS = ("pgm", "geojson", "svg", "dxf", "ply")


@pytest.fixture
def results(tmp_path: Path, finished: Finished) -> RunResults:
    """Return the results of a run in a room in which one wall has two pieces."""
    folder = tmp_path / "room"
    folder.mkdir()
    write_results(folder, finished, Config(), {"recording": "room.mcap"})
    return read_run_results(folder)


# Formats


def read_dxf(path: Path) -> tuple[set[str], dict[str, list[dict[int, list[str]]]]]:
    """Return the layers, and the entities by kind as values by group code; assert the structure of R12."""
    lines = path.read_bytes().decode("ascii").split("\r\n")
    assert lines.pop() == ""
    assert len(lines) % 2 == 0
    pairs = [(int(code), value) for code, value in zip(lines[::2], lines[1::2], strict=True) if int(code) != 999]
    assert pairs[-1] == (0, "EOF")
    sections: dict[str, list[tuple[int, str]]] = {}
    inside: list[tuple[int, str]] | None = None
    for k, pair in enumerate(pairs[:-1]):
        if pair == (0, "SECTION"):
            assert inside is None
            assert pairs[k + 1][0] == 2
            inside = sections[pairs[k + 1][1]] = []
        elif pair == (0, "ENDSEC"):
            inside = None
        else:
            assert inside is not None
            inside.append(pair)
    assert list(sections) == ["HEADER", "TABLES", "ENTITIES"]
    assert (1, "AC1009") in sections["HEADER"]
    layers = {record[2][0] for kind, record in records(sections["TABLES"]) if kind == "LAYER"}
    entities = defaultdict(list)
    for kind, record in records(sections["ENTITIES"][1:]):
        entities[kind].append(record)
    return layers, entities


def records(pairs: list[tuple[int, str]]) -> Iterator[tuple[str, dict[int, list[str]]]]:
    starts = [k for k, (code, _) in enumerate(pairs) if code == 0]
    for start, end in zip(starts, [*starts[1:], len(pairs)], strict=True):
        values = defaultdict(list)
        for code, value in pairs[start + 1 : end]:
            values[code].append(value)
        yield pairs[start][1], values


def point(entity: dict[int, list[str]], number: int = 0) -> list[float]:
    return [float(entity[code + number][0]) for code in (10, 20)]


def test_dxf_has_walls_as_lines_on_layers(results: RunResults, tmp_path: Path) -> None:
    write_dxf(tmp_path / "a.dxf", results)
    layers, entities = read_dxf(tmp_path / "a.dxf")
    assert layers == {"WALLS", "CORNERS", "PATH"}
    assert set(entities) == {"LINE", "POINT", "POLYLINE", "VERTEX", "SEQEND"}
    assert {e[8][0] for e in entities["LINE"]} == {"WALLS"}
    walls = np.array([[point(e), point(e, 1)] for e in entities["LINE"]])
    np.testing.assert_allclose(walls, results.walls.piece_points()[0], atol=1e-6)
    assert len(walls) == 5  # four walls, one with a door
    corners = [point(e) for e in entities["POINT"]]
    np.testing.assert_allclose(corners, results.corners.position, atol=1e-6)
    path = np.array([point(e) for e in entities["VERTEX"]])
    np.testing.assert_allclose(path[[0, -1]], results.trajectory.poses[[0, -1], :2], atol=1e-6)
    assert len(entities["POLYLINE"]) == len(entities["SEQEND"]) == 1


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
    assert left < 0 < 6 < left + width
    assert top < -4 < 0 < top + height
    walls = root.findall("s:g[@class='walls']/s:path", space)
    assert walls[0].attrib["d"] == "M0.000,0.000L6.000,0.000"
    assert walls[3].attrib["d"].count("M") == 2
    assert "M6.000,-4.000" in walls[2].attrib["d"]
    assert "standard deviation 3.2 mm across" in walls[0][0].text
    assert "standard deviation" not in walls[3][0].text
    corners = root.findall("s:g[@class='corners']/s:ellipse", space)
    assert len(corners) == 1
    assert float(corners[0].attrib["rx"]) == pytest.approx(3 * np.sqrt(4.414e-5), abs=1e-4)


@pytest.fixture
def uncertain(tmp_path: Path, finished: Finished) -> RunResults:
    """Return the results of a run whose path becomes ever less certain, and one wall at one end."""
    covariance = finished.walls.covariance.copy()
    covariance[0] = [[1e-4, 2e-4], [2e-4, 4e-4]]  # standard deviation across |0.01 + 0.02 d| at d metres
    sigma = np.linspace(0.0, 0.2, len(finished.keyframes))
    run = replace(
        finished,
        walls=replace(finished.walls, covariance=covariance),
        keyframe_covariance=np.eye(3) * np.square(sigma)[:, None, None],
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


# Command


@pytest.fixture
def ran(wclm: Any, fake_slam: type) -> Path:
    """Return the output directory of `wclm run`."""
    assert wclm("run", "sim:room?duration=3&seed=4", "--out", "out", "--no-review").exit_code == 0
    return Path("out")


@pytest.mark.parametrize("form", FORMATS)
def test_existing_export_is_replaced_only_with_overwrite(wclm: Any, ran: Path, form: str) -> None:
    before = {file.name for file in ran.iterdir()}
    name = "points.ply" if form == "ply" else f"map.{form}"
    result = wclm("map", ran, "--format", form)
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith(f"out/{name}: ")
    assert {file.name for file in ran.iterdir()} - before == {name} | ({"map.yaml"} if form == "pgm" else set())
    wclm.refuses("map", ran, "--format", form, because=[f"out/{name}: exists already", "--overwrite"])
    assert wclm("map", ran, "--format", form, "--overwrite").exit_code == 0
    assert wclm("map", ran, "--format", form, "--out", f"elsewhere.{form}").exit_code == 0
    assert Path(f"elsewhere.{form}").read_bytes() == (ran / name).read_bytes()
    wclm.refuses("map", ran, "--format", form, "--out", "a.b", because=["a.b: the name of a", f"end with .{form}"])
    assert wclm("run", "sim:room?duration=3", "--out", ran, "--no-review", "--overwrite").exit_code == 0
    assert not (ran / name).exists()  # it belonged to the older run


def test_no_picture_is_written_if_its_yaml_file_exists(wclm: Any, ran: Path) -> None:
    (ran / "map.yaml").write_text("mine")
    wclm.refuses("map", ran, "--format", "pgm", because=["out/map.yaml: exists already"])
    assert (ran / "map.yaml").read_text() == "mine"
    assert not list(ran.glob("*.pgm"))


def test_picture_shows_the_scans_on_the_trajectory(wclm: Any, ran: Path) -> None:
    result = wclm("map", ran, "--format", "pgm", "--resolution", "0.1")
    header, pixels = re.fullmatch(rb"(P5\n\d+ \d+\n255\n)(.*)", (ran / "map.pgm").read_bytes(), re.DOTALL).groups()
    width, height = (int(word) for word in header.split()[1:3])
    assert f"{width} x {height} cells of 0.1 m" in result.stdout
    picture = np.frombuffer(pixels, np.uint8).reshape(height, width)
    assert set(np.unique(picture)) == {0, 205, 254}
    assert 6.4 / 0.1 <= width <= 6.9 / 0.1  # the room and few outliers
    assert 4.2 / 0.1 <= height <= 4.7 / 0.1


def test_point_cloud_contains_all_returns(wclm: Any, ran: Path) -> None:
    result = wclm("map", ran, "--format", "ply")
    header, body = (ran / "points.ply").read_bytes().split(b"end_header\n", 1)
    lines = header.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    count = int(next(line for line in lines if line.startswith("element vertex")).split()[2])
    assert [line.split()[-1] for line in lines if line.startswith("property float")] == ["x", "y", "z"]
    points = np.array(list(struct.iter_unpack("<fff", body)))
    assert points.shape == (count, 3)
    assert f"{count} points" in result.stdout
    assert 20_000 < count < 29 * 920
    assert np.ptp(points[:, 0]) == pytest.approx(6.4, abs=0.1)
    assert not points[:, 2].any()


def test_missing_recording_is_an_error_and_can_be_replaced(wclm: Any, fake_slam: type) -> None:
    assert wclm("simulate", "room", "a.mcap", "--duration", "2").exit_code == 0
    assert wclm("run", "a.mcap", "--out", "out", "--no-review").exit_code == 0
    Path("a.mcap").rename("b.mcap")
    for form in ("pgm", "ply"):
        wclm.refuses("map", "out", "--format", form, because=["a.mcap does not exist any more", "--recording FILE"])
        assert wclm("map", "out", "--format", form, "--recording", "b.mcap").exit_code == 0
    assert wclm("map", "out", "--format", "dxf").exit_code == 0  # needs no recording
    assert wclm("simulate", "room", "late.mcap", "--duration", "2").exit_code == 0
    trajectory = Path("out/trajectory.tum")
    rows = [line.split(" ", 1) for line in trajectory.read_text().splitlines()]
    trajectory.write_text("".join(f"{float(stamp) + 1e6:.6f} {rest}\n" for stamp, rest in rows))
    other = ("map", "out", "--format", "pgm", "--overwrite", "--recording", "late.mcap")
    wclm.refuses(*other, because=["late.mcap has no scan at the times of its path"])
    wclm.refuses(*other[:-1], "nowhere.mcap", because=["nowhere.mcap: no such file"])


def test_summary_without_recording_is_an_error(wclm: Any, ran: Path) -> None:
    summary = json.loads((ran / "summary.json").read_text())
    del summary["recording_path"], summary["recordings"]
    write_json(ran / "summary.json", summary)
    (ran / "keyframes.csv").unlink()
    wclm.refuses("map", ran, "--format", "pgm", because=["does not say where its recording sim:room is"])
    assert wclm("map", ran, "--format", "pgm", "--recording", "sim:room?duration=3").exit_code == 0
    assert wclm("map", ran, "--format", "svg").exit_code == 0


@pytest.mark.parametrize("command", ["map {} --format svg", "map {} --format pgm", "report {}"])
def test_invalid_directory_is_refused(wclm: Any, ran: Path, command: str) -> None:
    def refuses(directory: str, *because: str) -> None:
        wclm.refuses(*command.format(directory).split(), because=because)

    refuses("nowhere", "nowhere: is not a directory")
    Path("empty").mkdir()
    refuses("empty", "empty: has no map.json; expected the output directory of `wclm run`")
    (ran / "report.html").unlink()
    for name, broken, words in (
        ("summary.json", "{", "summary.json: is not JSON"),
        ("summary.json", "[]", "summary.json: is not the summary of a run"),
        ("map.json", "{}", "map.json: is not a map"),
        ("keyframes.csv", "a,b\n", "keyframes.csv:1: the header is not stamp,x,y"),
        ("trajectory.tum", "1 2 3\n", "trajectory.tum:1: expected 8 numbers"),
    ):
        content = (ran / name).read_bytes()
        (ran / name).write_text(broken)
        refuses("out", words)
        (ran / name).write_bytes(content)


def test_contradictory_thresholds_are_a_usage_error(wclm: Any, ran: Path) -> None:
    result = wclm("map", ran, "--format", "pgm", "--free", "0.5", "--occupied", "0.4")
    assert result.exit_code == 2
    assert "must be less than --occupied" in result.stderr


# Keyframes


def test_keyframes_are_read_back_with_their_covariances(tmp_path: Path, finished: Finished) -> None:
    from slam.io.keyframes_csv import Keyframes, write_keyframes

    random = np.random.default_rng(3).normal(0, 0.01, (len(finished.keyframes), 3, 3))
    covariance = random @ random.transpose(0, 2, 1)
    covariance[2] = np.nan
    write_keyframes(tmp_path / "a.csv", Keyframes(finished.keyframe_stamps, finished.keyframes, covariance))
    read = read_keyframes(tmp_path / "a.csv")
    np.testing.assert_allclose(read.stamps, finished.keyframe_stamps, atol=1e-6)
    np.testing.assert_allclose(read.poses, finished.keyframes, atol=1e-6)
    np.testing.assert_allclose(read.covariance, covariance, rtol=1e-8)
    sigma = read.position_sigma()
    assert np.isnan(sigma[2])
    for k in (0, 1, 3, 4, 5):
        assert sigma[k] == pytest.approx(np.sqrt(np.linalg.eigvalsh(covariance[k, :2, :2]).max()))


@pytest.mark.parametrize("spec", ["ld06:tape:in?tape={}", "ld06:tape:in?tape={} + create2:x", "replay:{}"])
def test_a_foreign_summary_opens_no_device_and_writes_no_file(wclm: Any, ran: Path, tmp_path: Path, spec: str) -> None:
    """Even if a file has the name of a device specification."""
    out = tmp_path / "written-outside"
    Path(spec.format(out)).mkdir(parents=True)
    Path(spec.format(out), "in").touch()
    summary = json.loads((ran / "summary.json").read_text())
    summary |= {"recording_path": spec.format(out), "recordings": []}
    write_json(ran / "summary.json", summary)
    wclm.refuses("map", ran, "--format", "pgm", because=["the directory is not a ROS 2 bag"])
    assert not out.exists()
