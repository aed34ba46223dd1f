"""The examples run, print the expected results, and write no files."""

import runpy
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"
EXPECTED = {
    "map_a_recording.py": ["sim:room?duration=10: 350 poses", "m, standard deviations"],
    "own_sensors.py": [" 9.9 s: at ", "the room has 4 walls and 4 corners"],
    "features_of_a_scan.py": ["a wall 3.9998 m", "a corner at -2.0"],
}
WITH_PICTURES = {
    "features_of_a_scan.py": ([], ["a wall 3.9998 m"], "<ellipse"),
    "measure_a_recording.py": (
        ["sim:room?duration=10"],
        ["<sim:room: 6 walls", "m apart, standard deviation", "room 1: 26."],
        'class="dimensions"',
    ),
    "map_arrays.py": (
        [],
        ["<Finished: 8 walls, ", "joint covariance of 8 walls: (16, 16)", "error of the path (RMS): 0."],
        "ellipses: 100 standard deviations",
    ),
    "own_factors.py": ([], ["by odometry the mark is 20.6", "by the tape 20.1", "with both 20.1"], "<polyline"),
}
"""Arguments before the name of the picture that an example writes, expected texts, and an element of the picture."""


def test_every_example_is_tested() -> None:
    assert {file.name for file in EXAMPLES.glob("*.py")} == set(EXPECTED) | set(WITH_PICTURES)


def run(name: str, *arguments: str) -> None:
    """Run an example as a program, in this process: most of the time of its own process would be imports."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [str(EXAMPLES / name), *arguments])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")


@pytest.mark.parametrize("name", EXPECTED)
def test_example_prints_the_expected_results(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    run(name)
    out, err = capfd.readouterr()
    assert err == ""
    for text in EXPECTED[name]:
        assert text in out
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[] if name == "measure_a_recording.py" else pytest.mark.slow) for name in WITH_PICTURES],
)
def test_example_prints_the_expected_results_and_draws_a_picture_if_one_is_named(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    arguments, expected, element = WITH_PICTURES[name]
    monkeypatch.chdir(tmp_path)
    run(name, *arguments, "picture.svg")
    out, err = capfd.readouterr()
    assert err == ""
    for text in expected:
        assert text in out
    assert [file.name for file in tmp_path.iterdir()] == ["picture.svg"]
    picture = (tmp_path / "picture.svg").read_text()
    assert ElementTree.fromstring(picture).tag.endswith("svg")
    assert element in picture


@pytest.mark.slow
def test_an_example_runs_in_a_process_of_its_own(tmp_path: Path) -> None:
    command = [sys.executable, "-W", "error", EXAMPLES / "own_sensors.py"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=200, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    for text in EXPECTED["own_sensors.py"]:
        assert text in result.stdout
