"""`wclm demo --gallery`: the documentation's pictures, and that what they show is computed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from slam.cli.commands import demo_pictures
from slam.evaluation.benchmarks import monte_carlo
from slam.evaluation.benchmarks.monte_carlo import NOISE, Wall, corner_positions, deviations, line_parameters

AHEAD = Wall(3.0, 0.0, np.radians(-20.0), np.radians(20.0))


@pytest.fixture
def few_trials(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(monte_carlo, "TRIALS", 400)


def test_a_wall_is_measured_where_it_is() -> None:
    wall = Wall(2.0, 0.7, 0.2, 1.1)
    points = wall.ranges(wall.bearings)[:, None] * np.stack([np.cos(wall.bearings), np.sin(wall.bearings)], axis=1)
    np.testing.assert_allclose(points @ [np.cos(0.7), np.sin(0.7)], 2.0)
    np.testing.assert_allclose(wall.points(wall.span), points[[0, -1]], atol=1e-12)


def test_deviations_are_as_large_as_claimed(few_trials: None) -> None:
    seen = deviations(AHEAD, 1)
    np.testing.assert_allclose(seen.found.std(axis=0) / seen.claimed, 1.0, atol=0.15)
    assert seen.claimed.argmin() == len(seen.along) // 2


def test_errors_are_gaussian_in_uv_and_not_in_distance_and_direction(few_trials: None) -> None:
    short = Wall(4.0, 0.0, np.radians(-2.5), np.radians(2.6))
    uv, polar = line_parameters(short, monte_carlo.Noise(0.05, NOISE.sigma_bearing), 1)
    assert 0.90 < uv.within < 0.99
    assert polar.within < 0.8


def test_corners_are_within_their_ellipses(few_trials: None) -> None:
    other = Wall(3.0 * np.sin(0.35) + 0.2, np.pi / 2, np.radians(21.0), np.radians(60.0))
    cloud = corner_positions(AHEAD, other, 1)
    np.testing.assert_allclose(cloud.truth, [3.0, other.distance])
    assert 0.90 < cloud.within < 0.99


@pytest.mark.slow
def test_pictures_are_made_and_made_small(wclm: Any, few_trials: None, tmp_path: Path) -> None:
    everything = demo_pictures.picture_sets(None)
    only = [pictures for pictures in everything if "fit.png" in pictures.files]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demo_pictures, "picture_sets", lambda datasets: only)
        result = wclm("demo", "--gallery", "made/here")
    assert result.exit_code == 0, result.output
    assert result.stdout.split() == [f"made/here/{name}" for name in only[0].files]
    for name in only[0].files:
        with Image.open(tmp_path / "made" / "here" / name) as picture:
            assert picture.mode == "P"
            assert min(picture.size) > 300
    assert not (tmp_path / "demo").exists()


def test_a_directory_that_cannot_be_made_is_one_line(wclm: Any, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    wclm.refuses("demo", "--gallery", "file/here", because=["file/here: cannot be created"])


def test_recordings_are_drawn_where_they_are(tmp_path: Path) -> None:
    (tmp_path / "intel").mkdir()
    (tmp_path / "intel" / "intel.clf").write_text("")
    with_it = {name for pictures in demo_pictures.picture_sets(tmp_path) for name in pictures.files}
    assert with_it - {name for pictures in demo_pictures.picture_sets(None) for name in pictures.files} == {
        "intel.png",
        "intel-grid.png",
        "intel-corrections.png",
    }


@pytest.mark.slow
def test_all_pictures_of_drives_are_made(tmp_path: Path) -> None:
    for pictures in demo_pictures.picture_sets(None):
        scratch = tmp_path / Path(pictures.files[0]).stem
        scratch.mkdir()
        pictures.make(tmp_path, scratch)
        for name in pictures.files:
            assert (tmp_path / name).stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_the_demo_closes_its_loop(wclm: Any, tmp_path: Path, seed: int) -> None:
    result = wclm("demo", "--seed", seed, "--no-view")
    assert result.exit_code == 0, result.output
    assert "1 loop closed" in result.stdout
    assert "rejected" not in result.stdout
    assert (tmp_path / "demo" / "closure.png").stat().st_size > 10_000
