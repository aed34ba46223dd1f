"""A part of `wclm bench features`: results are reproducible and as good as documented."""

from __future__ import annotations

import numpy as np
import pytest

from features import warm_up
from features.benchmark import timing
from features.benchmark.accuracy import COARSE, FINE, METHODS, Level, Row, measure
from features.benchmark.rooms import NOTHING, simulate
from features.benchmark.start import start_once
from features.types import Noise

DEFAULT = METHODS[:1]


def evaluate(level: Level, *, curved: bool = False) -> Row:
    return next(measure(scans=100, seed=1, levels=[level], methods=DEFAULT, curved=curved))


@pytest.mark.parametrize(
    ("level", "precision", "recall", "corner_recall"),
    [
        (Level(0.01, FINE, 0.0), 0.999, 0.999, 0.994),
        pytest.param(Level(0.05, COARSE, 0.0), 0.985, 0.975, 0.94, marks=pytest.mark.slow),
        pytest.param(Level(0.01, FINE, 0.01), 0.985, 0.993, 0.98, marks=pytest.mark.slow),
    ],
)
def test_features_are_as_accurate_as_documented(
    level: Level, precision: float, recall: float, corner_recall: float
) -> None:
    """The limits of the full run are tighter; a hundred scans scatter by about half a per cent."""
    row = evaluate(level)
    assert row.precision >= precision
    assert row.recall >= recall
    assert row.corner_recall >= corner_recall
    assert row.corner_nees <= 2.4


@pytest.mark.parametrize(("sigma", "corners"), [(0.005, 0.06), (0.02, 0.15)])
def test_curves_have_few_false_corners(sigma: float, corners: float) -> None:
    """Without the test for curves each one has one to two corners."""
    row = evaluate(Level(sigma, FINE, 0.0), curved=True)
    assert row.curves > 300
    assert row.curved_corners < corners
    assert row.recall > 0.99


def test_results_depend_on_the_seed_only() -> None:
    first, second, other = (
        list(measure(scans=4, seed=seed, levels=[Level(0.01, FINE, 0.01)], methods=METHODS)) for seed in (0, 0, 1)
    )
    assert first == second
    assert first != other
    assert {row.method for row in first} == {
        *("split/wclm-ml", "split/wclm", "split/arras-siegwart", "split/siadat"),
        *("tracking 20 mm/wclm", "tracking 3 sigma/wclm"),
    }


@pytest.mark.parametrize("curved", [False, True])
def test_simulated_rays_end_on_their_surface(curved: bool) -> None:
    for number in range(6):
        scan = simulate(np.random.default_rng(number), Noise(1e-9, 0.0), number=number, curved=curved)
        hit = (scan.surface != NOTHING) & (scan.surface < len(scan.walls))
        points = (scan.ranges * np.exp(1j * scan.angles))[hit]
        walls = scan.walls[scan.surface[hit]]
        start, end = walls[:, 0] + 1j * walls[:, 1], walls[:, 2] + 1j * walls[:, 3]
        across = ((points - start) * np.conj(end - start)).imag / np.abs(end - start)
        assert np.abs(across).max() < 1e-6
        assert (scan.surface >= len(scan.walls)).any() == curved


def test_every_method_is_timed() -> None:
    warm_up()
    rows = timing.run(beams=(180,), scans=3, rounds=2)
    assert {row.name for row in rows} >= {"split/wclm-ml", "split/siadat", "tracking/wclm"}
    for row in rows:
        assert row.beams == 180
        assert row.lines > 3
        assert 0 < row.median_us <= row.p99_us
        assert 0 < row.compiled_us < row.best_us <= row.p99_us


def test_extraction_works_without_the_compiler() -> None:
    plain = start_once("plain", {"NUMBA_DISABLE_JIT": "1"}, 2, 1)
    assert plain.scan_us > 2000
    assert plain.import_s > 0
    assert not plain.memory_mb <= plain.numpy_mb
