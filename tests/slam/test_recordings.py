"""The public benchmark recordings, where they are at hand, scored against the relations their surveyors checked."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import drivers
from slam import Slam
from slam.evaluation import read_relations, score_relations
from slam.trajectory import Trajectory

ROOT = Path(__file__).parents[2]
FOLDER = Path(os.environ.get("WCLM_DATASETS", ROOT.parent / "shared" / "datasets"))


def score(name: str, seconds: float | None = None, *, refine: bool = False) -> dict[str, float]:
    """The scores of the first `seconds` of a recording, or of all of it."""
    folder = FOLDER / name
    if not (folder / f"{name}.clf").exists() or not (folder / f"{name}.relations").exists():
        pytest.skip(f"{folder} is not there; set WCLM_DATASETS to the folder that holds {name}/{name}.clf")
    slam, start = Slam(refine=refine), None
    for message in drivers.open(folder / f"{name}.clf"):
        start = message.stamp if start is None else start
        if seconds is not None and message.stamp - start > seconds:
            break
        slam.add(message)
    finished = slam.finish()
    relations = read_relations(folder / f"{name}.relations")
    return score_relations(Trajectory(finished.stamps, finished.poses), relations).figures()


def test_the_first_minutes_of_intel() -> None:
    figures = score("intel", 600.0)
    assert figures["relations"] > 500
    assert figures["trans_mean"] < 0.024
    assert figures["rot_mean"] < 0.6


@pytest.mark.slow
def test_intel() -> None:
    figures = score("intel")
    assert figures["missing"] == 0
    assert figures["trans_mean"] < 0.024
    assert figures["rot_mean"] < 0.9


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "translation", "rotation"), [("intel", 0.019, 0.65), ("fr079", 0.035, 0.55), ("csail", 0.030, 0.45)]
)
def test_the_second_look(name: str, translation: float, rotation: float) -> None:
    figures = score(name, refine=True)
    assert figures["missing"] == 0
    assert figures["trans_mean"] <= translation
    assert figures["rot_mean"] <= rotation
