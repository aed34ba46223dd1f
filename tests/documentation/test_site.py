"""The documentation builds, is up to date, and fetches nothing from other hosts."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType

import pytest

from .blocks import PAGES, ROOT
from .test_named_sections import anchors

PICTURES = ROOT / "docs" / "pictures"
LINK = re.compile(r"\]\(([^)#]+?)(#[^)]*)?\)")


def _tool(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / "tools" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("page", ["commands.md", "configuration.md"])
def test_generated_pages_are_up_to_date(page: str) -> None:
    written = _tool("reference").PAGES[page]()
    assert (ROOT / "docs" / page).read_text(encoding="utf-8") == written, "run `make reference`"


def test_configuration_page_lists_settings_and_devices() -> None:
    text = (ROOT / "docs" / "configuration.md").read_text(encoding="utf-8")
    for words in ("| `sigma_range` | `0.01` | > 0, < 1 |", "`wclm-ml`, `wclm`", "| `wheels` |", "| `dtr` | bases |"):
        assert words in text


def test_links_of_the_readme_exist() -> None:
    targets = [match[1] for match in LINK.finditer((ROOT / "README.md").read_text(encoding="utf-8"))]
    assert len(targets) > 10
    for target in targets:
        assert target.startswith("https://") or (ROOT / target).exists(), target


def test_pictures_are_small_and_all_are_used() -> None:
    from slam.cli.commands.demo_pictures import all_picture_sets

    made = {file for pictures in all_picture_sets(Path()) for file in pictures.files}
    sizes = {path.name: path.stat().st_size for path in PICTURES.iterdir()}
    assert set(sizes) == made
    assert max(sizes.values()) < 200_000
    assert sum(sizes.values()) < 1_500_000
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES.values())
    for name in made:
        assert f"pictures/{name})" in text


class _Page(HTMLParser):
    """Parser for the resources that a browser fetches with a page, and for its formulas."""

    def __init__(self) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.formulas: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag in ("script", "img", "source", "iframe"):
            self.fetched.append(given.get("src") or "")
        elif tag == "link" and given.get("rel") in ("stylesheet", "preconnect", "icon", "preload"):
            self.fetched.append(given.get("href") or "")
        elif (given.get("class") or "") == "formula":
            self.formulas.append(given.get("aria-label") or "")


def test_links_between_pages_exist() -> None:
    links = [
        (page, *match.groups())
        for page, path in PAGES.items()
        for match in LINK.finditer(path.read_text(encoding="utf-8"))
        if not match[1].startswith(("http", "mailto:"))
    ]
    assert len(links) > 100
    for page, target, section in links:
        file = (ROOT / page).parent / target
        assert file.exists(), f"{page}: {target}"
        if section and file.suffix == ".md":
            assert section[1:] in anchors(file.relative_to(ROOT).as_posix()), f"{page}: {target}{section}"


@pytest.mark.slow  # `make docs` also builds it strictly
def test_site_builds_and_refers_to_no_other_host(tmp_path: Path) -> None:
    answer = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", tmp_path / "site"],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        timeout=200,
    )
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout + answer.stderr == ""
    pages = list((tmp_path / "site").glob("*.html"))
    assert len(pages) >= len(PAGES)  # the site has no README, but 404.html
    formulas = []
    for path in pages:
        text = path.read_text(encoding="utf-8")
        page = _Page()
        page.feed(text)
        assert not [url for url in page.fetched if url.startswith(("http", "//"))], path.name
        assert "arithmatex" not in text, f"{path.name} has a formula that was not rendered"
        formulas += page.formulas
    assert r"u \cos\theta + v \sin\theta = \frac{1}{\rho} ." in formulas
    assert not (tmp_path / "site" / "tools").exists()
