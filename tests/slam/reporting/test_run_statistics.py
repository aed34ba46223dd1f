"""Statistics of a run: how well its scans fitted the map."""

from types import SimpleNamespace
from typing import Any

import pytest

from slam.localisation.tracking import TrackingStatus
from slam.reporting.run_statistics import RunStatistics


def health(scans: list[tuple[float, float]]) -> dict[str, object]:
    """Return the health of a run with scans of these wall lengths (metres) and overlap ratios."""
    statistics = RunStatistics()
    for length, ratio in scans:
        scan: Any = SimpleNamespace(features=SimpleNamespace(segments=SimpleNamespace(total_length=length)))
        registration = SimpleNamespace(overlap_ratio=ratio)
        tracking: Any = SimpleNamespace(registration=registration, slipped=False, status=TrackingStatus.TRACKED)
        statistics.add_tracking(scan, tracking)
    return statistics.health()


def test_a_drive_among_columns_has_no_overlap_ratio() -> None:
    """Pieces of a few columns look straight now and then. A correct map was said to have an overlap ratio of 0 %."""
    found = health([(0.0, 0.0)] * 7 + [(0.8, 0.0)] * 3)
    assert found["overlap_ratio_median"] is None
    assert found["overlap_ratio_p05"] is None


def test_scans_without_walls_do_not_lower_the_overlap_ratio() -> None:
    found = health([(6.0, 0.95)] * 7 + [(0.0, 0.0)] * 3)
    assert found["overlap_ratio_median"] == found["overlap_ratio_p05"] == pytest.approx(0.95)
    assert health([(6.0, 0.1)] * 7 + [(0.0, 0.0)] * 3)["overlap_ratio_median"] == pytest.approx(0.1)
