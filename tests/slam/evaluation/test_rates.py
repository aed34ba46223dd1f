import pytest
from scipy.special import bdtr

from slam.evaluation.rates import upper_limit


@pytest.mark.parametrize(("count", "trials"), [(0, 25), (2, 142), (19, 20)])
def test_the_limit_is_the_rate_with_which_so_few_events_are_unlikely(count: int, trials: int) -> None:
    assert bdtr(count, trials, upper_limit(count, trials)) == pytest.approx(0.05)


def test_nothing_is_known_without_trials() -> None:
    assert upper_limit(0, 0) == upper_limit(3, 3) == 1.0
    with pytest.raises(ValueError, match="4 events in 3 trials"):
        upper_limit(4, 3)
