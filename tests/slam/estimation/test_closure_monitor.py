"""Monitoring of loop closures ends, also if the robot adds no keyframes any more."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from slam.estimation import closure_monitor
from slam.estimation.closure_monitor import ClosureMonitor
from slam.preprocessing.preprocessor import NO_FEATURES, ProcessedScan


@dataclass
class Decision:
    status: str = ""
    reason: str = ""


@pytest.mark.parametrize(("scans", "monitored"), [(5, True), (6, False)])
def test_a_closure_is_monitored_for_a_limited_number_of_scans(
    monkeypatch: pytest.MonkeyPatch, scans: int, monitored: bool
) -> None:
    monkeypatch.setattr(closure_monitor, "MONITORED_SCANS", 5)
    mapper: Any = SimpleNamespace(travelled=[0.0])
    monitor, decision, checkpoint = ClosureMonitor(), Decision(), SimpleNamespace(mapper=mapper)
    monitor.add(checkpoint, decision)  # type: ignore[arg-type]
    for k in range(scans):
        monitor.record(ProcessedScan(float(k), np.zeros(3), NO_FEATURES))
    assert (monitor.contradicted(mapper, lost=True) is not None) == monitored
