"""Monitoring of loop closures ends, also if the robot adds no keyframes any more, and keeps little."""

import weakref
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from slam.estimation import closure_monitor
from slam.estimation.closure_monitor import ClosureMonitor
from slam.graph.isam2 import IncrementalSolver
from slam.preprocessing.preprocessor import NO_FEATURES, ProcessedScan


@dataclass
class Decision:
    status: str = ""
    reason: str = ""


def mapper_with(solver: Any) -> Any:
    return SimpleNamespace(travelled=[0.0], graph=SimpleNamespace(solver=solver))


def record(monitor: ClosureMonitor, scans: int) -> None:
    for k in range(scans):
        monitor.record(ProcessedScan(float(k), np.zeros(3), NO_FEATURES))


def test_the_isam2_of_a_checkpoint_is_dismissed_with_the_next_scan() -> None:
    """The closure itself is still reported with it."""
    solver, monitor = IncrementalSolver(), ClosureMonitor()
    monitor.add(SimpleNamespace(mapper=mapper_with(solver)), Decision())  # type: ignore[arg-type]
    held = weakref.ref(solver.isam)
    assert held() is not None
    record(monitor, 1)
    assert held() is None


@pytest.mark.parametrize(("scans", "monitored"), [(5, True), (6, False)])
def test_a_closure_is_monitored_for_a_limited_number_of_scans(
    monkeypatch: pytest.MonkeyPatch, scans: int, monitored: bool
) -> None:
    monkeypatch.setattr(closure_monitor, "MONITORED_SCANS", 5)
    mapper = mapper_with(IncrementalSolver())
    monitor, decision, checkpoint = ClosureMonitor(), Decision(), SimpleNamespace(mapper=mapper)
    monitor.add(checkpoint, decision)  # type: ignore[arg-type]
    record(monitor, scans)
    assert (monitor.contradicted(mapper, lost=True) is not None) == monitored
