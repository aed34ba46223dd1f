"""Corrections by hand in words: those that the map before hardly admits are called doubtful."""

from __future__ import annotations

import pytest

from slam.visualisation.report_page.correction_text import outcome_lines

CLOSED = {"keyframe": 120, "old": 3, "shift": 1.2, "fit": 0.9, "known": 0.8, "merged": 4}
TIED = {"offset": 0.08, "turn": 0.01}


@pytest.mark.parametrize("outcome", [CLOSED, TIED])
@pytest.mark.parametrize(("deviations", "doubtful"), [(0.5, False), (3.6, False), (4.2, True), (78.0, True)])
def test_a_correction_that_the_uncertainty_does_not_admit_is_doubtful(outcome, deviations, doubtful):
    first, *others = outcome_lines({**outcome, "deviations": deviations})
    assert f"{deviations:.1f} standard deviations" in first
    assert [line.startswith("DOUBTFUL") for line in others] == [True] * doubtful
