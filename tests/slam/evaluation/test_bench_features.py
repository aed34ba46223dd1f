"""`wclm bench features --quick`: provenance, tables, JSON and plot."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest


@pytest.mark.slow
def test_the_command_prints_and_writes_all_figures(wclm: Any, tmp_path: Path) -> None:
    file, folder = tmp_path / "features.json", tmp_path / "pictures"
    result = wclm("bench", "features", "--quick", "--seed", "3", "--json", str(file), "--out", str(folder))
    assert result.exit_code == 0, result.output
    for word in ("processor", "numba", "seed 3", "split/wclm-ml", "tracking 20 mm", "corner NEES", "times a reference"):
        assert word in result.output
    assert "NaN" not in file.read_text(encoding="utf-8")
    content = json.loads(file.read_text(encoding="utf-8"))
    assert content["seed"] == 3
    assert content["machine"]["cores"] >= 1
    assert {row["method"] for row in content["rooms"]} >= {"split/wclm-ml", "split/siadat", "tracking 20 mm/wclm"}
    assert all(row["curves"] > 0 for row in content["curved rooms"])
    assert (folder / "tables.txt").read_text(encoding="utf-8").startswith("processor")
    assert (folder / "features.png").read_bytes().startswith(b"\x89PNG")


def test_an_unwritable_directory_is_an_error_message(wclm: Any, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    result = wclm("bench", "features", "--quick", "--out", str(tmp_path / "taken"))
    assert result.exit_code == 2
    assert "taken" in result.output
    assert "Traceback" not in result.output
