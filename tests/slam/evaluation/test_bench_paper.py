"""Tables, claims and plots of `wclm bench paper`, on a small part of its measurements."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from features import ESTIMATORS, Noise
from slam.evaluation.benchmarks.paper import formulas, timing, uncertainty
from slam.evaluation.benchmarks.paper.claims import FAILS, HOLDS, IN_PART, judge
from slam.evaluation.benchmarks.paper.environments import PAPER_NOISE, Environment
from slam.evaluation.benchmarks.paper.numbers import TABLE_1, TABLE_2, TABLE_3, TABLE_4
from slam.evaluation.benchmarks.paper.run import environments, measure, measure_times
from slam.evaluation.benchmarks.paper.tables import lines

SMALL: dict[str, int] = {"sweeps": 3, "tracked": 1}
COUNTS = {"A": (884, 54, 26), "B": (1112, 20, 8)}
SIZES = {"A": (12.0, 8.0), "B": (5.0, 3.0)}
"""Points, segments and corners stated in the paper, and sizes in metres; doors are slightly recessed."""


@pytest.fixture(scope="module")
def worlds() -> dict[str, Environment]:
    return environments()


@pytest.fixture(scope="module")
def measured() -> dict[str, Any]:
    return measure(3, **SMALL)


@pytest.fixture(scope="module")
def times() -> dict[str, Any]:
    return measure_times(rounds=3)  # in a single round, another process may have interrupted any call


def numbers(tree: Any) -> Iterator[float]:
    if isinstance(tree, dict | list):
        for branch in tree.values() if isinstance(tree, dict) else tree:
            yield from numbers(branch)
    elif not isinstance(tree, str):
        yield float(tree)


@pytest.mark.parametrize("name", ["A", "B"])
def test_environments_have_the_stated_sizes_and_counts(worlds: dict[str, Environment], name: str) -> None:
    world = worlds[name]
    assert (len(world.angles), len(world.segments), len(world.corners)) == COUNTS[name]
    assert np.ptp(world.world.segments.reshape(-1, 2), axis=0) == pytest.approx(
        {"A": (12, 8), "B": (5, 3)}[name], abs=0.1
    )
    rays = np.concatenate([segment.rays for segment in world.segments])
    assert len(set(rays.tolist())) == len(rays)


def test_curved_cabinets_have_the_papers_corners(worlds: dict[str, Environment]) -> None:
    world = worlds["A"]
    curved = [k for k, pair in enumerate(world.corners, 1) if min(world.segments[s].wall for s in pair) < 0]
    assert curved == [6, 7, 8, 9, 13, 14]


def test_measured_ranges_lie_on_their_walls(worlds: dict[str, Environment]) -> None:
    for world in worlds.values():
        exact = world.measure(np.random.default_rng(0), Noise(0.0, 0.0))
        assert exact == pytest.approx(world.ranges, abs=1e-9)
        error = world.measure(np.random.default_rng(0), Noise(0.05, 0.0)) - world.ranges
        assert np.std(error) == pytest.approx(0.05, rel=0.1)


@pytest.mark.slow
def test_tables_have_every_row_of_the_paper(measured: dict[str, Any], times: dict[str, Any]) -> None:
    for name, printed in (("A", TABLE_1), ("B", TABLE_2)):
        rows = measured["environments"][name]["table"]
        assert [row["corner"] for row in rows] == printed[:, 0].tolist()
        beside = [[*row["paper"]["wclm"], *row["paper"]["arras-siegwart"], *row["paper"]["siadat"]] for row in rows]
        assert np.array_equal(beside, printed[:, 1:])
    for name, printed in (("A20", TABLE_3), ("B4", TABLE_4)):
        assert [row["points"] for row in times[name]] == printed[:, 0].tolist()


@pytest.mark.slow
def test_all_figures_are_finite_and_spreads_positive(measured: dict[str, Any], times: dict[str, Any]) -> None:
    assert all(np.isfinite(value) for value in numbers([measured, times]))
    for world in measured["environments"].values():
        assert min(numbers([[row["ours"], row["paper"]] for row in world["table"]])) > 0.0
    assert min(numbers(times)) > 0.0


@pytest.mark.slow
def test_measurements_without_times_are_repeatable(measured: dict[str, Any]) -> None:
    again, other = measure(3, **SMALL), measure(4, **SMALL)
    assert json.dumps(again) == json.dumps(measured)
    assert json.dumps(other) != json.dumps(measured)


@pytest.mark.slow
def test_siadat_equals_arras_siegwart_for_the_same_weights(measured: dict[str, Any]) -> None:
    for world in measured["environments"].values():
        assert world["siadat with the same weights differs by"] < 1e-9
        for row in world["table"]:
            assert row["ours"]["siadat"] == pytest.approx(row["ours"]["arras-siegwart"], rel=1e-9)


@pytest.mark.parametrize("number", [4, 9, 20])
def test_the_papers_formulas_agree_with_the_compiled_estimators(worlds: dict[str, Environment], number: int) -> None:
    world = worlds["A"]
    ranges = world.measure(np.random.default_rng(1))
    walls = [(ranges[rays], world.angles[rays], PAPER_NOISE) for rays in world.rays_of_corner(number)]
    double = partial(formulas.arras_siegwart, sums="double")
    for name, fit, meet in (
        ("wclm", formulas.wclm, formulas.wclm_corner),
        ("arras-siegwart", formulas.arras_siegwart, formulas.arras_siegwart_corner),
        ("arras-siegwart", double, formulas.arras_siegwart_corner),
        ("siadat", formulas.siadat, formulas.siadat_corner),
    ):
        estimator = ESTIMATORS[name]
        expected = estimator.corner(*(estimator.fit(*wall) for wall in walls))
        found = meet(*(fit(*wall) for wall in walls))
        assert found[0] == pytest.approx(expected[0], rel=1e-9)
        assert np.allclose(found[1], expected[1], rtol=1e-8, atol=0.0)


@pytest.mark.parametrize("fit", [formulas.arras_siegwart, formulas.siadat])
def test_equal_weights_have_exact_jacobians(worlds: dict[str, Environment], fit: Any) -> None:
    rays = worlds["A"].rays_of_corner(20)[0]
    ranges, angles = worlds["A"].ranges[rays], worlds["A"].angles[rays]
    step = 1e-6
    columns = []
    for side in (0, 1):
        for k in range(len(rays)):
            moved = np.zeros((2, len(rays)))
            moved[side, k] = step
            ahead = fit(ranges + moved[0], angles + moved[1], PAPER_NOISE, power=0).parameters
            behind = fit(ranges - moved[0], angles - moved[1], PAPER_NOISE, power=0).parameters
            sigma = (PAPER_NOISE.sigma_range, PAPER_NOISE.sigma_bearing)[side]
            columns.append(sigma * (ahead - behind) / (2 * step))
    jacobian = np.array(columns).T
    covariance = fit(ranges, angles, PAPER_NOISE, power=0).covariance
    assert np.abs(jacobian @ jacobian.T - covariance).max() < 1e-6 * np.abs(covariance).max()


def test_all_timed_forms_compute_the_same_corner(worlds: dict[str, Environment]) -> None:
    walls = timing.half_each(worlds["B"], 4, 60)
    expected = worlds["B"].positions[3]
    for call in timing.numpy_calls(walls).values():
        assert call()[0] == pytest.approx(expected, abs=1e-9)  # type: ignore[index]
    for name, call in timing.compiled_calls(walls).items():
        x, y, cxx, cxy, cyy = call()  # type: ignore[misc]
        assert (x, y) == pytest.approx(tuple(expected), abs=1e-9)
        covariance = timing.numpy_calls(walls)[name]()[1]  # type: ignore[index]
        assert [[cxx, cxy], [cxy, cyy]] == pytest.approx(covariance, rel=1e-8)


@pytest.mark.slow
def test_arras_siegwart_is_quadratic_only_with_double_sums(times: dict[str, Any]) -> None:
    first, last = times["B4"][0]["compiled"], times["B4"][-1]["compiled"]
    assert last["arras-siegwart, double sums"] > 5.0 * first["arras-siegwart, double sums"]
    assert last["arras-siegwart, double sums"] > 5.0 * last["arras-siegwart, single sums"]


@pytest.mark.slow
def test_wclm_covariances_are_consistent(worlds: dict[str, Environment]) -> None:
    for world in worlds.values():
        figures = uncertainty.consistency(uncertainty.measure(world, 0, sweeps=40))
        for method in ("wclm", "wclm-ml"):
            assert 0.91 < figures[method]["within_95"] < 0.98


@pytest.mark.slow
def test_verdicts_follow_from_the_measurements(measured: dict[str, Any], times: dict[str, Any]) -> None:
    claims = judge(measured, times)
    verdicts = {claim.says.split()[0]: claim.verdict for claim in judge(measured, None)}
    assert len(claims) == len(verdicts) + 4
    assert {claim.verdict for claim in claims} <= {HOLDS, IN_PART, FAILS}
    assert verdicts["Siadat"] == FAILS
    assert verdicts["Lines"] == FAILS
    changed = json.loads(json.dumps(measured))
    for world in changed["environments"].values():
        world["siadat with the same weights differs by"] = 0.3
    for row in changed["tracking"]:
        row["tracking"]["walls"] = 0.95
    verdicts = {claim.says.split()[0]: claim.verdict for claim in judge(changed, None)}
    assert verdicts["Siadat"] == HOLDS
    assert verdicts["Lines"] == HOLDS


@pytest.mark.slow
def test_tables_are_printed_in_full(measured: dict[str, Any], times: dict[str, Any]) -> None:
    text = "\n".join(lines(measured, times, judge(measured, times)))
    for heading in ("Table I:", "Table II:", "Table III:", "Table IV:", "Figure 5:"):
        assert heading in text
    assert "385.8 / 117.0" in text
    assert "4757.09" in text


@pytest.mark.slow
def test_the_command_writes_tables_json_and_plots(
    wclm: Any, monkeypatch: pytest.MonkeyPatch, measured: dict[str, Any], times: dict[str, Any]
) -> None:
    monkeypatch.setattr("slam.evaluation.benchmarks.paper.run.measure", lambda seed: measured | {"seed": seed})
    monkeypatch.setattr("slam.evaluation.benchmarks.paper.run.measure_times", lambda: times)
    result = wclm("bench", "paper", "--json", "all.json", "--out", "pictures", "--seed", 5)
    assert result.exit_code == 0, result.output
    content = json.loads(Path("all.json").read_text())
    assert content["measured"]["seed"] == 5
    assert set(content) == {"machine", "versions", "seed", "claims", "measured", "times"}
    pictures = {path.name for path in Path("pictures").glob("*.png")}
    assert pictures == {"environment-a.png", "environment-b.png", "figure-5.png", "siadat.png", "tracking.png"}
    assert Path("pictures/tables.txt").read_text() == result.stdout


def test_an_unwritable_directory_is_an_error_message(wclm: Any) -> None:
    Path("file").touch()
    wclm.refuses("bench", "paper", "--out", "file", because=["file", "cannot be created"])
