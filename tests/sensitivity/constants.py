"""Constants of the source code, where their values are from, and copies of the code with other values."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator
from itertools import accumulate

ORIGIN = "Origin:"
ESTIMATED = ("chosen", "tuned", "measured")
"""Origins of values that might be somewhat larger or smaller; the others follow from a definition or a model."""
FUNCTIONS = ("np.array", "np.radians", "math.radians", "math.log", "math.sqrt", "np.sqrt", "float")
"""Functions whose result may be multiplied."""


def find_constants(tree: ast.Module) -> Iterator[tuple[str, ast.Assign | ast.AnnAssign]]:
    """Yield the module-level assignments of an expression with a number in it to an upper-case name."""
    for node in tree.body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            first = target.elts[0] if isinstance(target, ast.Tuple) else target
            leaves = (leaf.value for leaf in ast.walk(node.value) if isinstance(leaf, ast.Constant))
            has_number = any(isinstance(leaf, int | float) and not isinstance(leaf, bool) for leaf in leaves)
            if isinstance(first, ast.Name) and first.id.strip("_").isupper() and has_number:
                yield first.id, node


def comment_of(lines: list[str], node: ast.stmt) -> str:
    """Return the comment lines directly above a statement, and the comments on its own lines."""
    first = node.lineno - 1
    while first > 0 and lines[first - 1].lstrip().startswith("#"):
        first -= 1
    return "\n".join(line.partition("#")[2] for line in lines[first : node.end_lineno])


def count_estimated(text: str) -> int:
    """Return the number of constants of a module that are estimated, or have the origin of an estimated one."""
    lines, count = text.splitlines(), 0
    for _, node in find_constants(ast.parse(text)):
        origins = re.findall(rf"{ORIGIN}\s+([a-z-]+)", comment_of(lines, node))
        if origins[-1:] and origins[-1] in (*ESTIMATED, "as"):
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            count += len(target.elts) if isinstance(target, ast.Tuple) else 1
    return count


def change_constants(text: str, draw: Callable[[], float]) -> tuple[str, int]:
    """Return the text of a module whose estimated constants are multiplied by factors, and the number of the changed.

    Each number, and each other expression, has a factor of its own from `draw`, which is at most 2. Of a share between
    0.5 and 1, what is missing to 1 is multiplied. Whole numbers stay whole, and at least 1. Objects and series of
    values stay as they are.
    """
    lines, edits = text.splitlines(), list[tuple[ast.expr, str]]()
    for _, node in find_constants(ast.parse(text)):
        origins = re.findall(rf"{ORIGIN}\s+([a-z-]+)", comment_of(lines, node))
        if origins[-1:] and origins[-1] in ESTIMATED and node.value is not None:
            edits += _changes(node.value, draw)
    content = "\n".join(lines).encode()  # columns of a syntax tree count bytes
    starts = [0, *accumulate(len(line.encode()) + 1 for line in lines)]
    for value, changed in sorted(edits, key=lambda edit: (-edit[0].lineno, -edit[0].col_offset)):
        first = starts[value.lineno - 1] + value.col_offset
        end = starts[(value.end_lineno or 0) - 1] + (value.end_col_offset or 0)
        content = content[:first] + changed.encode() + content[end:]
    return content.decode() + "\n", len(edits)


def _changes(value: ast.expr, draw: Callable[[], float]) -> Iterator[tuple[ast.expr, str]]:
    """Yield the parts of the value of a constant that are changed, and what replaces each of them."""
    if isinstance(value, ast.Tuple | ast.List):
        for element in value.elts:
            yield from _changes(element, draw)
    elif isinstance(value, ast.Constant):
        if isinstance(value.value, int | float):
            yield value, repr(_changed(value.value, draw()))
    elif isinstance(value, ast.BinOp | ast.UnaryOp) or (
        isinstance(value, ast.Call) and ast.unparse(value.func) in FUNCTIONS
    ):
        yield value, f"({ast.unparse(value)}) * {draw()!r}"


def _changed(value: float, factor: float) -> float:
    """Return a number multiplied by a factor; if it is a share between 0.5 and 1, what is missing to 1."""
    if isinstance(value, int):
        return max(1, round(value * factor))
    return 1.0 - (1.0 - value) * factor if 0.5 < value < 1.0 else value * factor
