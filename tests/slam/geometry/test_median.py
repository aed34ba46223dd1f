"""The weighted median."""

import numpy as np
import pytest

from slam.geometry.median import weighted_median


@pytest.mark.parametrize("count", [1, 2, 5, 200])
def test_weighted_median_is_the_quantile_of_numpy(count: int) -> None:
    random = np.random.default_rng(count)
    values, weights = random.normal(size=count), random.random(count)
    assert weighted_median(values, weights) == np.quantile(values, 0.5, weights=weights, method="inverted_cdf")


def test_values_without_weight_do_not_count() -> None:
    assert weighted_median(np.array([9.0, 1.0, 2.0, 3.0, 8.0]), np.array([0.0, 1.0, 1.0, 1.0, 0.0])) == 2.0
