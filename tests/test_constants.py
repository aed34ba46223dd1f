"""Every numeric constant of the estimator core states where its value is from."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

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
    "checks",
    "estimation",
)
ORIGIN = "Origin:"


def constants(tree: ast.Module) -> Iterator[tuple[str, ast.Assign | ast.AnnAssign]]:
    """Yield the module-level assignments of an expression with a number in it to an upper-case name."""
    for node in tree.body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            first = target.elts[0] if isinstance(target, ast.Tuple) else target
            numbers = (leaf for leaf in ast.walk(node.value) if isinstance(leaf, ast.Constant))
            if (
                isinstance(first, ast.Name)
                and first.id.strip("_").isupper()
                and any(isinstance(leaf.value, int | float) and not isinstance(leaf.value, bool) for leaf in numbers)
            ):
                yield first.id, node


def comment_of(lines: list[str], node: ast.stmt) -> str:
    """Return the comment lines directly above a statement, and the comments on its own lines."""
    first = node.lineno - 1
    while first > 0 and lines[first - 1].lstrip().startswith("#"):
        first -= 1
    return "\n".join(line.partition("#")[2] for line in lines[first : node.end_lineno])


@pytest.mark.parametrize("package", CORE)
def test_every_constant_states_its_origin(package: str) -> None:
    files = sorted((SLAM / package).rglob("*.py"))
    assert files
    missing = []
    for file in files:
        text = file.read_text(encoding="utf-8")
        lines, found = text.splitlines(), constants(ast.parse(text))
        missing += [f"{file.name}: {name}" for name, node in found if ORIGIN not in comment_of(lines, node)]
    assert not missing, f"no comment with '{ORIGIN}' for {', '.join(missing)}"


def test_a_missing_origin_is_found() -> None:
    text = "GATE = 13.8  # chi-square\n# Metres. Origin: convention.\nREACH = 2.0\nNAMES = ('a', 'b')\n"
    lines = text.splitlines()
    found = {name: ORIGIN in comment_of(lines, node) for name, node in constants(ast.parse(text))}
    assert found == {"GATE": False, "REACH": True}
