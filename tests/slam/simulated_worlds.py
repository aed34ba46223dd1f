"""Simulated worlds for tests: drives that end earlier than in the benchmark, and a room that is not symmetric."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from drivers.simulation import Simulation, World, build_world, load_world_file
from drivers.simulation.world import Box
from slam.evaluation.benchmarks.lookalike import simulation_of


def limit_drives(monkeypatch: pytest.MonkeyPatch, seconds: float, rate: float | None = None) -> None:
    """Let drives in simulated worlds end after some seconds; with a rate, measure only so many scans per second."""

    def limited(*arguments: Any) -> Simulation:
        simulation = simulation_of(*arguments)
        simulation.duration = seconds
        simulation.lidar = replace(simulation.lidar, rate=rate or simulation.lidar.rate)
        return simulation

    monkeypatch.setattr("slam.evaluation.benchmarks.lookalike.simulation_of", limited)


def furnished_room() -> World:
    """Return the room with a cupboard at one of its walls, which tells it from the room turned by 180 degrees."""
    content = load_world_file("room")
    cupboard = Box(at=(6.1, 2.1), size=(0.5, 1.2))
    return build_world("furnished", content.model_copy(update={"boxes": [*content.boxes, cupboard]}))
