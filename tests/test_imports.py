"""Imports go one way only. They are read from the source: nothing needs to be installed or run."""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("kernel_cache", "features", "drivers", "slam")
FILES = sorted(file for package in PACKAGES for file in (ROOT / package).rglob("*.py"))

CONFINED = {
    "gtsam": "slam/graph",
    "rerun": "slam/visualisation/rerun_log",
    "serial": "drivers",
    "distributed": "slam/offline/batch",
    "zenoh": "drivers/ros2",
    "cyclonedds": "drivers/ros2",
    "rclpy": "drivers/ros2",
}
"""Libraries and the one folder that may import them."""

LAYERS = (
    "errors", "extras", "formatting", "memory", "bounds", "config", "geometry", "graph", "odometry", "mapping",
    "matching", "preprocessing", "localisation", "loop_closure", "recognition", "checks", "events", "estimation",
    "measuring", "io", "reporting", "run_setup", "run_start", "run_session", "run_end", "pose_extrapolation",
    "pipeline", "warmup", "offline", "evaluation", "visualisation", "run_saving", "session_correction",
    "mapped_recording", "run_recording", "ros", "cli",
)  # fmt: skip
"""Packages and modules of `slam`, from bottom to top: each may import those before it."""


@cache
def imported(file: Path) -> frozenset[str]:
    """Return the absolute dotted names that a file imports, wherever in it."""
    return frozenset(_imports(file))


def _imports(file: Path) -> Iterator[str]:
    package = file.relative_to(ROOT).parent.parts
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else ()
            yield ".".join([*above, *([node.module] if node.module else [])])


def name_of(file: Path) -> str:
    return file.relative_to(ROOT).as_posix()


@pytest.mark.parametrize(
    ("package", "allowed"), [("kernel_cache", ()), ("features", ("kernel_cache",)), ("drivers", ("kernel_cache",))]
)
def test_imports_go_one_way(package: str, allowed: tuple[str, ...]) -> None:
    others = {f"{other}." for other in PACKAGES if other not in (package, *allowed)}
    found = {
        name_of(file): names
        for file in FILES
        if name_of(file).startswith(f"{package}/")
        and (names := [name for name in imported(file) if any(f"{name}.".startswith(other) for other in others)])
    }
    assert not found, f"{package} knows nothing of the other packages"


def layer_of(name: str) -> int | None:
    """Return the layer of a dotted name or of a file, None if it is not below `slam`."""
    parts = name.removesuffix(".py").replace("/", ".").split(".")
    return LAYERS.index(parts[1]) if parts[0] == "slam" and len(parts) > 1 and parts[1] != "__init__" else None


def test_imports_within_slam_go_downwards() -> None:
    layers = {name_of(file): own for file in FILES if (own := layer_of(name_of(file))) is not None}
    assert layers
    above = {
        name_of(file): names
        for file in FILES
        if (own := layers.get(name_of(file))) is not None
        and (names := [name for name in imported(file) if (layer := layer_of(name)) is not None and layer > own])
    }
    assert not above


@pytest.mark.parametrize(("library", "folder"), CONFINED.items())
def test_libraries_stay_where_they_belong(library: str, folder: str) -> None:
    importing = {name_of(file) for file in FILES if library in {name.split(".")[0] for name in imported(file)}}
    assert importing
    assert all(name.startswith(f"{folder}/") for name in importing), importing


def test_relative_imports_are_resolved() -> None:
    names = imported(ROOT / "slam" / "visualisation" / "plots" / "map.py")
    assert "slam.mapping.map_features" in names
    assert "slam.visualisation.plots.style" in names
