"""Sections of the documentation that the code names exist."""

import re

from .blocks import ROOT

PACKAGES = ("features", "drivers", "slam", "kernel_cache")


def anchors(page: str) -> set[str]:
    """Return the names of the sections of a page, as links state them."""
    text = (ROOT / page).read_text(encoding="utf-8")
    titles = re.findall(r"^#+ (.+)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title).strip().lower().replace(" ", "-") for title in titles}


def test_sections_that_modules_name_exist() -> None:
    named = {
        (file.relative_to(ROOT).as_posix(), page, section)
        for package in PACKAGES
        for file in (ROOT / package).rglob("*.py")
        for page, section in re.findall(r"(docs/[\w-]+\.md)#([\w-]+)", file.read_text(encoding="utf-8"))
    }
    assert named
    assert [place for place in sorted(named) if place[2] not in anchors(place[1])] == []
