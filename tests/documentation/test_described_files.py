"""The page on the files of a run describes what is in them."""

from __future__ import annotations

import re

from slam.io.sessions.header import SessionHeader

from .blocks import ROOT


def test_the_header_of_a_session_is_described_completely() -> None:
    page = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    described = set(re.findall(r"`([a-z_0-9]+)`", page))
    schema = SessionHeader.model_json_schema(mode="validation")
    stored = {key for record in (schema, *schema["$defs"].values()) for key in record["properties"]}
    assert "scan_stamp" in stored
    assert stored - described == set()
