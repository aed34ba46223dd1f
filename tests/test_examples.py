"""The examples run, say something sensible, and nothing else."""

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"
SAYS = {
    "map_a_recording.py": ["sim:room?duration=10: 251 poses", "m, known to"],
    "own_sensors.py": [" 9.9 s: at ", "the room has 4 walls and 4 corners"],
    "features_of_a_scan.py": ["a wall 3.9998 m", "a corner at -2.0"],
}


def test_every_example_is_run() -> None:
    assert {file.name for file in EXAMPLES.glob("*.py")} == set(SAYS)


@pytest.mark.parametrize("name", SAYS)
def test_example(name: str, tmp_path: Path) -> None:
    answer = subprocess.run(
        [sys.executable, "-W", "error", EXAMPLES / name], capture_output=True, text=True, timeout=200, cwd=tmp_path
    )
    assert answer.returncode == 0, answer.stderr
    assert answer.stderr == ""
    for words in SAYS[name]:
        assert words in answer.stdout
    assert not list(tmp_path.iterdir())
