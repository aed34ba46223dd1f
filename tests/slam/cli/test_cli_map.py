"""`wclm map`: files that it writes, and its errors."""

import json
import re
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Scan
from drivers.recordings.mcap import McapWriter
from drivers.simulation import LidarModel, Simulation
from slam import extras
from slam.io.json_files import write_json
from slam.io.run_results import read_run_results

FORMATS = ("pgm", "geojson", "svg", "dxf", "ply")


@pytest.fixture
def ran(wclm: Any, fake_slam: type) -> Path:
    """Return the output directory of `wclm run`."""
    assert wclm("run", "sim:room?duration=3&seed=4", "--out", "out", "--no-review").exit_code == 0
    return Path("out")


@pytest.mark.parametrize("form", ["geojson", "svg", "dxf", "g2o"])
def test_formats_without_points_refuse_a_recording(wclm: Any, form: str) -> None:
    wclm.refuses("map", "out", "--format", form, "--recording", "a.clf", because=["--recording: is for pgm and ply"])


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
    wclm.refuses("map", ran, "--format", form, "--out", "a.b", because=[f"a.b: the name must end with .{form}"])
    assert wclm("run", "sim:room?duration=3", "--out", ran, "--no-review", "--overwrite").exit_code == 0
    assert not (ran / name).exists()  # it belonged to the older run


def test_dxf_without_ezdxf_names_the_extra(wclm: Any, ran: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = {file.name for file in ran.iterdir()}
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    wclm.refuses("map", ran, "--format", "dxf", because=["needs the extra 'plans'"])
    assert {file.name for file in ran.iterdir()} == before


@pytest.mark.parametrize("resolution", ["0", "-1", "nan", "inf", "1e300"])
def test_cells_have_a_size_that_a_map_can_have(wclm: Any, ran: Path, resolution: str) -> None:
    arguments = ["--format", "pgm", "--resolution", resolution]
    wclm.refuses("map", ran, *arguments, because=["--resolution", "Input should be"])


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


def test_the_recording_of_another_drive_is_refused(wclm: Any) -> None:
    for world in ("room", "office"):
        assert wclm("simulate", world, f"{world}.mcap", "--duration", "3").exit_code == 0
    assert wclm("run", "room.mcap", "--out", "out", "--no-review").exit_code == 0
    for form in ("pgm", "ply"):
        other = ("map", "out", "--format", form, "--recording", "office.mcap")
        wclm.refuses(*other, because=["out: its map was not made from the scans of office.mcap"])
        assert wclm("map", "out", "--format", form).exit_code == 0


def test_points_are_where_the_walls_are_if_the_mount_was_found(wclm: Any) -> None:
    """The recording does not state that the lidar points backwards."""
    drive = Simulation("office", duration=20.0, lidar=LidarModel(beams=180, rate=5.0), mount=(0.0, 0.0, np.pi))
    with McapWriter(Path("drive.mcap")) as writer:
        for message in drive:
            writer.write(replace(message, mount=None) if isinstance(message, Scan) else message)
    result = wclm("run", "drive.mcap", "--out", "out", "--no-review")
    assert "lidar turned by" in result.stdout
    assert wclm("map", "out", "--format", "ply").exit_code == 0
    body = Path("out/points.ply").read_bytes().split(b"end_header\n")[1]
    points = np.frombuffer(body, dtype="<f4").reshape(-1, 3)[:, :2].astype(np.float64)
    walls = read_run_results(Path("out")).walls
    on_walls = np.zeros(len(points), dtype=bool)
    for frame, low, high in zip(walls.frame, walls.low, walls.high, strict=True):
        along, across = se2.transform(se2.inverse(frame), points).T
        on_walls |= (np.abs(across) < 0.05) & (along > low) & (along < high)
    assert on_walls.mean() > 0.8


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

    refuses("nowhere", "nowhere: no such directory")
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


def test_an_unknown_format_names_the_known_ones(wclm: Any, ran: Path) -> None:
    wclm.refuses("map", "out", "--format", "xyz", because=["Invalid value for '--format': 'xyz' is not one of 'pgm', "])


def test_contradictory_thresholds_are_a_usage_error(wclm: Any, ran: Path) -> None:
    result = wclm("map", ran, "--format", "pgm", "--free", "0.5", "--occupied", "0.4")
    assert result.exit_code == 2
    assert "must be less than --occupied" in result.stderr


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
