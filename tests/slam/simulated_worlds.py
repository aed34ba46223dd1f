"""Drives through worlds whose places look alike that end earlier than in the benchmark."""

from __future__ import annotations

from typing import Any

import pytest

from drivers.simulation import Simulation
from slam.evaluation.benchmarks.lookalike import simulation_of


def limit_drives(monkeypatch: pytest.MonkeyPatch, seconds: float) -> None:
    """Let drives in simulated worlds end after some seconds."""

    def limited(*arguments: Any) -> Simulation:
        simulation = simulation_of(*arguments)
        simulation.duration = seconds
        return simulation

    monkeypatch.setattr("slam.evaluation.benchmarks.lookalike.simulation_of", limited)
