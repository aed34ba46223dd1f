"""The page on the files of a run describes what is in them."""

from __future__ import annotations

import json
import re
from pathlib import Path

from typer.testing import CliRunner

from slam.cli.app import app
from slam.io.output_dir import SUMMARY
from slam.io.sessions.header import SESSION_VERSION, SessionHeader

from .blocks import ROOT

PAGE = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")


def test_the_stated_version_of_sessions_is_the_present_one() -> None:
    stated = re.findall(r"`version` (\d+); a program", PAGE) + re.findall(r"this one reads version (\d+) only", PAGE)
    assert stated == [str(SESSION_VERSION)] * 2


def test_the_header_of_a_session_is_described_completely() -> None:
    """Apart from the settings, which have a page of their own."""
    described = set(re.findall(r"`([a-z_0-9]+)`", PAGE))
    schema = SessionHeader.model_json_schema(mode="validation")
    records = [record for name, record in schema["$defs"].items() if not name.endswith("Config")]
    stored = {key for record in (schema, *records) for key in record["properties"]}
    assert "scan_stamp" in stored
    assert stored - described == set()


def test_the_summary_of_a_run_is_described_completely(tmp_path: Path) -> None:
    arguments = ["run", "sim:room?duration=3&lidar=short", "--out", str(tmp_path / "out"), "--no-review"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    summary = json.loads((tmp_path / "out" / SUMMARY).read_text())
    described = set(re.findall(r"`([a-z_0-9]+)`", PAGE.split("## `summary.json`")[1].split("\n## ")[0]))
    assert {*summary, *summary["slam"]} - described == set()
