"""Results of a run that was made elsewhere, or damaged."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from slam.config import Config
from slam.errors import MapError
from slam.events import Finished
from slam.io.output_dir import SUMMARY
from slam.io.run_results import read_run_results, write_results

COMPLETE: dict[str, Any] = {"slam": {"loops": {}}, "warnings": [], "devices": []}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"slam": 3}, "slam is not a table"),
        ({"slam": [1]}, "slam is not a table"),
        ({"skipped": "none"}, "skipped is not a table"),
        ({"warnings": {"a": 1}}, "warnings is not a list"),
        ({"devices": [1]}, "recordings or devices has an entry that is not a table"),
    ],
)
def test_a_summary_with_other_types_is_refused(
    tmp_path: Path, finished: Finished, change: dict[str, Any], message: str
) -> None:
    write_results(tmp_path, finished, Config(), COMPLETE)
    read_run_results(tmp_path)
    (tmp_path / SUMMARY).write_text(json.dumps(COMPLETE | change))
    with pytest.raises(MapError) as caught:
        read_run_results(tmp_path)
    assert str(caught.value) == f"{tmp_path / SUMMARY}: {message}"
