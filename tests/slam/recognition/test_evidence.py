"""Evidence for a place is a likelihood ratio, and what fits everywhere is none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from slam.recognition import evidence
from slam.recognition.evidence import CellFits, chances_of_fit, evidence_of
from slam.recognition.location import RECOGNISED

ERROR = 0.01  # probability of a wrong decision


def fits_of(shares: Sequence[float], known: Sequence[bool] | None = None, walls: int = 0) -> CellFits:
    """Return the fits of cells, of which the last ones are on long `walls`; without `known`, all are known."""
    count = len(shares)
    return CellFits(
        np.array(shares),
        np.ones(count, dtype=bool) if known is None else np.array(known),
        np.arange(count) >= count - walls,
    )


def test_cells_that_fit_everywhere_are_no_evidence() -> None:
    alike = chances_of_fit([fits_of([1.0] * 40)] * 51)[0]
    assert evidence_of(fits_of([1.0] * 40), alike) < 0.5
    distinctive = chances_of_fit([fits_of([0.0] * 40)] * 51)[0]
    assert evidence_of(fits_of([1.0] * 40), distinctive) > 100.0


def test_cells_in_unseen_space_are_no_evidence() -> None:
    chance = np.full(30, 0.4)
    seen = evidence_of(fits_of([1.0] * 20), chance[:20])
    assert evidence_of(fits_of([1.0] * 20 + [0.0] * 10, [True] * 20 + [False] * 10), chance) == pytest.approx(seen)


def test_each_cell_that_misfits_lowers_the_evidence() -> None:
    values = [evidence_of(fits_of([1.0] * (30 - k) + [0.0] * k), np.full(30, 0.4)) for k in range(30)]
    assert (np.diff(values) <= 1e-9).all()
    assert values[0] > 10.0
    assert values[-1] < 0.0


def test_a_place_that_only_looks_alike_rarely_has_much_evidence() -> None:
    """By Markov's inequality, a likelihood ratio of 1 / p occurs with a probability of at most p."""
    random = np.random.default_rng(1)
    chance = random.uniform(0.2, 0.9, 60)
    exceeded = 0
    for _ in range(2000):
        fit = (random.uniform(size=60) < chance).astype(float)
        exceeded += evidence_of(fits_of(fit.tolist()), chance) > -np.log(ERROR)
    assert exceeded <= 2000 * ERROR


def test_chance_of_a_cell_is_the_share_of_the_places_where_it_fits() -> None:
    others = [fits_of([1.0, 0.0, 1.0], [True, True, False]), fits_of([1.0, 1.0, 1.0], [True, True, False])]
    chances = chances_of_fit([fits_of([1.0, 1.0, 1.0]), *others])
    mean = (3 + 1) / (4 + 2)  # of all cells of the others, three of four of which fit
    np.testing.assert_allclose(chances[0], [(2 + 2 * mean) / 4, (1 + 2 * mean) / 4, mean])
    mean = (5 + 1) / (5 + 2)
    np.testing.assert_allclose(chances[1], [(2 + 2 * mean) / 4, (2 + 2 * mean) / 4, (1 + 2 * mean) / 3])


def test_what_has_changed_fits_by_chance() -> None:
    """At the right place most cells are as they were; of the others, those on bare walls fit as anywhere."""
    random = np.random.default_rng(2)
    chance = np.repeat([0.95, 0.2], [60, 20])
    changed = random.uniform(size=80) < 0.3
    fit = np.where(changed, random.uniform(size=80) < chance, 1.0)
    assert evidence_of(fits_of(fit.tolist()), chance) > evidence_of(fits_of(fit[60:].tolist()), chance[60:]) - 0.5


def test_a_wall_that_is_missing_counts_for_the_one_that_it_hides(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evidence, "UNCHANGED_PROBABILITIES", np.ones(1))
    monkeypatch.setattr(evidence, "ALIKE_OFFSETS", np.zeros(1))
    missing = np.log((1.0 - evidence.MAX_FIT) / 0.5)
    for walls, count in ((0, 3.0), (1, 4.0), (3, 6.0)):
        assert evidence_of(fits_of([0.0] * 3, walls=walls), np.full(3, 0.5)) == pytest.approx(count * missing)
    assert evidence_of(fits_of([1.0], walls=1), np.full(1, 0.5)) == pytest.approx(np.log(evidence.MAX_FIT / 0.5))


def test_furniture_that_was_moved_together_is_less_evidence_than_the_walls_that_stayed() -> None:
    """Forty cells of furniture fit beside the right place, and ten of walls fit at it."""
    chance, moved, right = np.full(50, 0.4), [1.0] * 40 + [0.0] * 10, [0.0] * 40 + [1.0] * 10
    assert evidence_of(fits_of(moved), chance) > RECOGNISED.required
    assert evidence_of(fits_of(moved, walls=10), chance) < RECOGNISED.required - 8.0
    assert evidence_of(fits_of(right, walls=10), chance) > evidence_of(fits_of(right), chance)


@pytest.mark.slow
def test_long_walls_rarely_look_alike_with_much_evidence() -> None:
    random = np.random.default_rng(3)
    chance = random.uniform(0.2, 0.9, 60)
    fits = [fits_of((random.uniform(size=60) < chance).astype(float).tolist(), walls=30) for _ in range(2000)]
    assert sum(evidence_of(fit, chance) > -np.log(ERROR) for fit in fits) <= 2000 * ERROR
