"""A real viewer shows logs without an error and in the colours of the legend."""

from __future__ import annotations

import importlib.util
import io
import time
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

from slam.events import (
    Event,
    KeyframeAdded,
)
from slam.visualisation.rerun_log import colours
from slam.visualisation.rerun_log.blueprint import layout
from slam.visualisation.rerun_log.combined_log import extent_of, write_combined_log
from slam.visualisation.rerun_log.log_files import find_log
from slam.visualisation.rerun_log.rrd_reader import chunks_of

from ..closure_log import write
from ..corridor import Corridor
from ..viewers import errors, load, pixels_of, viewer


def viewer_picture() -> ModuleType:
    """Return the program of the documentation that draws a log."""
    path = Path(__file__).parents[3] / "docs" / "tools" / "viewer_picture.py"
    spec = importlib.util.spec_from_file_location("viewer_picture", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def pictures(path: Path, timeline: str, sequence: int, views: Sequence[str]) -> dict[str, np.ndarray]:
    with viewer() as client:
        load(client, path)
        client.set_time(timeline=timeline, sequence=sequence, play_state="paused")
        time.sleep(1.5)
        by_name = {view.name: view.view_id for view in client.get_state().views}
        assert errors(client) == []
        shots = {name: io.BytesIO(client.take_screenshot(by_name[name])) for name in views}
    return {name: np.array(Image.open(shot).convert("RGB")) for name, shot in shots.items()}


@pytest.mark.slow
def test_the_map_and_a_correction_are_shown_in_their_colours(closure_log: Path) -> None:
    shown = pictures(closure_log, "closure", 1, ["Map", "Before / after"])
    for colour in (colours.WALL, colours.MATCHED, colours.ESTIMATE, colours.CORNER, colours.CLOSURE):
        assert pixels_of(shown["Map"], colour) > 50, colour
    for colour in (colours.WALL, colours.BEFORE, colours.CLOSURE):
        assert pixels_of(shown["Before / after"], colour) > 50, colour
    assert pixels_of(shown["Map"], colours.BEFORE) < 20


@pytest.mark.parametrize("size", [pytest.param("1920x1080", marks=pytest.mark.slow), "1280x720"])
def test_the_log_opens_at_the_closure_without_errors_in_a_window(closure_log: Path, tmp_path: Path, size: str) -> None:
    with viewer():
        pass  # skip the test if there is none
    assert viewer_picture().take_picture(closure_log, tmp_path / "viewer.png", size) == []
    picture = np.array(Image.open(tmp_path / "viewer.png").convert("RGB"))
    assert f"{picture.shape[1]}x{picture.shape[0] + viewer_picture().TITLE_BAR}" == size
    left, right = picture[:, : picture.shape[1] * 4 // 11], picture[:, picture.shape[1] * 4 // 11 :]
    assert pixels_of(left, colours.WALL) > 500
    for colour in (colours.BEFORE, colours.CLOSURE):  # what is seen right after the correction, and not at the end
        assert pixels_of(right, colour) > 100, colour


@pytest.mark.slow
def test_views_of_loop_decisions_are_shown_if_there_are_any(
    corridor: tuple[Path, list[Event]], closure_log: Path, tmp_path: Path
) -> None:
    without = corridor[0]
    write_combined_log([find_log(without)], ["one"], tmp_path / "reviewed.rrd")  # with the layout of this version
    for log, expected in ((without, 0), (tmp_path / "reviewed.rrd", 0), (closure_log, 1)):
        with viewer() as client:
            load(client, log)
            names = [view.name for view in client.get_state().views]
            for name in ("Loop decisions", "Last loop", "Compared points", "Before / after"):
                assert names.count(name) == expected, (log, name)


def test_the_log_of_a_robot_that_was_only_localised_opens_on_the_timeline_of_its_scans(
    corridor: tuple[Path, list[Event]], tmp_path: Path
) -> None:
    added = [event for event in corridor[1] if isinstance(event, KeyframeAdded)]
    kept = [event for event in corridor[1] if not isinstance(event, KeyframeAdded) or event is added[0]]
    localised = write(tmp_path / "localised.rrd", kept)
    for log, mapped in ((localised, False), (corridor[0], True)):
        content = extent_of(list(chunks_of([log])))
        assert content.mapped == mapped
        assert layout(content).time_panel.timeline == ("keyframe" if mapped else "sensor_time")


@pytest.mark.slow
def test_two_logs_are_shown_side_by_side(corridor: tuple[Path, list[Event]], tmp_path: Path) -> None:
    other = write(tmp_path / "other.rrd", list(Corridor(step=2.0, start=1.0e9).events()))  # stamps are times of day
    write_combined_log([find_log(corridor[0]), find_log(other)], ["one", "an other"], tmp_path / "both.rrd")
    shown = pictures(tmp_path / "both.rrd", "keyframe", 20, ["one", "an_other"])
    for picture in shown.values():
        assert pixels_of(picture, colours.WALL) > 50
        assert pixels_of(picture, colours.ESTIMATE) > 50
