"""Results of tracking: the pose by the scan alone."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drivers import se2
from slam.matching.line_matcher import Registration
from slam.matching.point_matcher import Prediction

from ..tracking_results import tracking_result

small = st.floats(-0.02, 0.02)


@given(st.floats(-3.0, 3.0), st.tuples(small, small, small), st.floats(0.01, 100.0))
def test_the_pose_by_the_scan_alone_does_not_depend_on_the_prediction(
    heading: float, error: tuple[float, float, float], confidence: float
) -> None:
    by_scan, scan = np.array([2.0, -1.0, heading]), np.diag([4e4, 1e4, 9e4])
    prior = confidence * np.array([[2e4, 3e3, 0.0], [3e3, 1e4, 1e3], [0.0, 1e3, 4e4]])
    predicted = Prediction(se2.compose(by_scan, np.array(error)), prior)
    # What registration returns: the mean of both poses, weighted by their information.
    share = np.linalg.solve(scan + prior, prior)
    registration = Registration(se2.compose(by_scan, share @ error), scan, by_scan, np.zeros((3, 3)), 1.0, 1.0, 0)
    result = tracking_result(pose=by_scan, information=scan, registration=registration, predicted=predicted)
    assert np.abs(se2.between(by_scan, result.scan_pose)).max() < 0.1 * np.abs(share @ error).max() + 1e-6
