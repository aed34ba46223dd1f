"""The way of a line through the code, as its page states it, is that of the code."""

import re

from .blocks import ROOT

ROUTE = (ROOT / "docs" / "how-it-works.md").read_text(encoding="utf-8").split("## One line, ")[1]
CODE = "".join(
    path.read_text(encoding="utf-8") for name in ("features", "slam") for path in (ROOT / name).rglob("*.py")
)


def test_each_function_of_the_route_is_in_the_file_that_is_named() -> None:
    functions, callers = 0, []
    for row in (line for line in ROUTE.splitlines() if line.startswith("| ")):
        folder, waiting = None, []
        for name in re.findall(r"`([\w/.]+)`", row.rsplit(" | ", 1)[1]):
            if not name.endswith(".py"):
                waiting.append(name.rpartition(".")[2])
                continue
            path = ROOT / name if "/" in name else folder / name
            folder = path.parent
            text = path.read_text(encoding="utf-8")
            functions += len(waiting)
            missing = [one for one in waiting if not re.search(rf"(def|class) {one}\b", text)]
            assert missing == [], path
            waiting = []
        callers += waiting
    assert functions >= 15
    assert [name for name in callers if not re.search(rf"(def|class) {name}\b", CODE)] == []
