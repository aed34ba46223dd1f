"""Code blocks of the documentation and their requirements."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from functools import cache
from itertools import groupby
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = {
    page.relative_to(ROOT).as_posix(): page for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
}
BLOCK = re.compile(
    r"(?:^<!-- needs: (?P<needs>\w+) -->\n)?^```(?P<language>sh|python)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL
)
MENTION = re.compile(r"`(wclm [a-z][^`]*)`")
NEEDS = {"network", "robot", "emulator", "viewer", "cluster", "drives", "time"}
"""Requirements of a block that a quick test does not meet: a package index, a lidar and a base, a second terminal with
an emulated robot, a display, other computers, several drives through one building, minutes of time."""


@dataclass(frozen=True, slots=True)
class Block:
    """A code block: page, number on the page, language, requirement (empty: none), and text."""

    page: str
    number: int
    language: str
    needs: str
    text: str

    def __str__(self) -> str:
        return f"{self.page}-{self.number}"

    def commands(self) -> list[list[str]]:
        """Return the words of each command, without comments; `&` and `&&` separate commands of one line."""
        lines = [shlex.split(line, comments=True) for line in self.text.splitlines()]
        groups = (groupby(words, lambda word: word in ("&", "&&")) for words in lines)
        return [list(words) for line in groups for separates, words in line if not separates]


@cache
def blocks() -> tuple[Block, ...]:
    """Return all blocks of shell commands and Python of all pages."""
    return tuple(
        Block(name, number, match["language"], match["needs"] or "", match["text"])
        for name, page in PAGES.items()
        for number, match in enumerate(BLOCK.finditer(page.read_text(encoding="utf-8")), start=1)
    )


def mentions() -> list[tuple[str, list[str]]]:
    """Return the page and the words of each command within a sentence."""
    return [
        (name, shlex.split(match[1]))
        for name, page in PAGES.items()
        for match in MENTION.finditer(page.read_text(encoding="utf-8"))
    ]
