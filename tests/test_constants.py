"""Every numeric constant of the estimator core states where its value is from."""

import ast
from pathlib import Path

import pytest

from .sensitivity.constants import ORIGIN, change_constants, comment_of, count_estimated, find_constants

SLAM = Path(__file__).parents[1] / "slam"
CORE = (
    "geometry",
    "graph",
    "odometry",
    "preprocessing",
    "mapping",
    "matching",
    "localisation",
    "loop_closure",
    "recognition",
    "checks",
    "estimation",
)
MAX_ESTIMATED = 239
"""Number of constants of these packages that are chosen, measured or tuned. Whoever removes some lowers it."""


@pytest.mark.parametrize("package", CORE)
def test_every_constant_states_its_origin(package: str) -> None:
    files = sorted((SLAM / package).rglob("*.py"))
    assert files
    missing = []
    for file in files:
        text = file.read_text(encoding="utf-8")
        lines, found = text.splitlines(), find_constants(ast.parse(text))
        missing += [f"{file.name}: {name}" for name, node in found if ORIGIN not in comment_of(lines, node)]
    assert not missing, f"no comment with '{ORIGIN}' for {', '.join(missing)}"


def test_the_estimator_has_no_more_estimated_constants_than_before() -> None:
    files = [file for package in CORE for file in sorted((SLAM / package).rglob("*.py"))]
    assert sum(count_estimated(file.read_text(encoding="utf-8")) for file in files) <= MAX_ESTIMATED


def test_tuples_and_origins_of_other_constants_count_as_estimated() -> None:
    text = "A, B = 0.1, 4  # Origin: chosen.\nC = 2.0  # Origin: as A.\nD = 3.0  # Origin: definition.\n"
    assert count_estimated(text) == 3


def test_a_missing_origin_is_found() -> None:
    text = "GATE = 13.8  # chi-square\n# Metres. Origin: convention.\nREACH = 2.0\nNAMES = ('a', 'b')\n"
    lines = text.splitlines()
    found = {name: ORIGIN in comment_of(lines, node) for name, node in find_constants(ast.parse(text))}
    assert found == {"GATE": False, "REACH": True}


def test_only_estimated_constants_are_changed() -> None:
    text = """# Metres. Origin: chosen.
A, B = 0.1, 4
C = (0.9, math.radians(8.0))  # Origin: measured, é
# Origin: definition.
D = 3.0
E = Expectation(prior=0.5)  # Origin: chosen.
F = "x", 2.5
"""
    changed, count = change_constants(text, lambda: 2.0)
    assert count == 4
    assert changed == text.replace("0.1, 4", "0.2, 8").replace("0.9,", "0.8,").replace(
        "math.radians(8.0)", "(math.radians(8.0)) * 2.0"
    )
