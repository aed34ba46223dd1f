"""Run all measurements of the paper benchmark and return plain data for JSON, tables and plots."""

from __future__ import annotations

from typing import Any

import numpy as np

from ....geometry.segments import Floats
from . import timing, tracking, uncertainty
from .environments import PAPER_NOISE, Environment, environment_a, environment_b
from .numbers import TABLE_1, TABLE_2, TABLE_3, TABLE_4

PRINTED = {"A": TABLE_1, "B": TABLE_2}
"""Tables I and II by environment."""
TIMED = {"A20": TABLE_3, "B4": TABLE_4}
"""Tables III and IV by environment and corner."""
FIGURE_5 = (("A", 20), ("A", 22), ("B", 1), ("B", 4))
"""The corners of Figure 5."""


def environments() -> dict[str, Environment]:
    """Return the environments A and B."""
    return {"A": environment_a(), "B": environment_b()}


def measure(
    seed: int = 0, *, sweeps: int = uncertainty.UNCERTAINTY_SWEEPS, tracked: int = tracking.TRACKING_SWEEPS
) -> dict[str, Any]:
    """Run all measurements except timings; the result depends on the seed only, bit for bit.

    sweeps   simulated for the errors of corners
    tracked  sweeps per noise level for the segmentations
    """
    worlds = environments()
    return {
        "seed": seed,
        "sigma_range": PAPER_NOISE.sigma_range,
        "sigma_bearing": PAPER_NOISE.sigma_bearing,
        "environments": {name: _uncertainties(world, PRINTED[name], seed, sweeps) for name, world in worlds.items()},
        "figure_5": {f"{name}{corner}": _by_points(worlds[name], corner) for name, corner in FIGURE_5},
        "tracking": tracking.measure(list(worlds.values()), seed, tracked),
    }


def measure_times(rounds: int = timing.TIMING_ROUNDS) -> dict[str, Any]:
    """Return the times, microseconds, for the corners of Figure 5, which include those of Tables III and IV."""
    worlds = environments()
    return {
        f"{name}{corner}": timing.times(worlds[name], corner, _points(worlds[name], corner), rounds)
        for name, corner in FIGURE_5
    }


def _points(environment: Environment, corner: int) -> list[int]:
    table = TABLE_3 if environment.name == "A" else TABLE_4
    return timing.point_counts(environment, corner, int(table[-1, 0]))


def _by_points(environment: Environment, corner: int) -> dict[str, Any]:
    points = _points(environment, corner)
    return {"points": points, "sigma": timing.uncertainty_by_points(environment, corner, points)}


def _uncertainties(environment: Environment, printed: Floats, seed: int, sweeps: int) -> dict[str, Any]:
    found = uncertainty.measure(environment, seed, sweeps)
    claimed, size = found.claimed, np.ptp(environment.world.segments.reshape(-1, 2), axis=0)
    return {
        "size": size.tolist(),
        "points": len(environment.angles),
        "segments": len(environment.segments),
        "table": uncertainty.table(environment, found, printed),
        "consistency": uncertainty.consistency(found),
        "wclm over arras-siegwart": {
            "paper": uncertainty.ratios(printed[:, 1:3], printed[:, 3:5]),
            "ours": uncertainty.ratios(claimed["wclm"], claimed["arras-siegwart"]),
        },
        "siadat over arras-siegwart": {
            "paper": uncertainty.ratios(printed[:, 5:7], printed[:, 3:5]),
            **uncertainty.siadat_variants(environment, seed),
        },
        "siadat with the same weights differs by": uncertainty.difference_of_equals(environment, seed),
        "siadat's excess in the paper": uncertainty.siadat_excess(printed),
    }
