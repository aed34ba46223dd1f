"""Line estimators: published golden values, derivatives against finite differences, invariances, equivalences."""

from __future__ import annotations

import numpy as np
import pytest

from features import ESTIMATORS, LineFit, Noise, arras_siegwart, siadat, wclm
from features.conversions import covariance_through, polar_of_uv

NOISE = Noise(0.05, np.radians(0.1955))

# Distance, normal angle, first and last bearing, number of rays. The golden values agree with two independent
# implementations.
WALLS = {
    "near": (1.7, 0.7, 0.2, 1.3, 12),
    "behind": (1.2, 2.2707963267948967, 1.6, 2.9, 15),
}
GOLDEN = {
    "near": {
        "wclm": (
            [0.4522249401871881, -0.3772780250092843],
            [8.667070076138648e-05, 6.416556841712785e-05, 8.72044156721242e-05],
        ),
        "polar": (
            [1.6979761636347852, 0.6952912311441204],
            [0.0001975299796184493, 5.501778362610148e-05, 0.00043279085241813023],
        ),
        "arras-siegwart": (
            [1.6978769262559432, 0.695269314992681],
            [0.00019722003202454853, 5.571631429653184e-05, 0.0004334363379381888],
        ),
        "siadat": [0.7678812085405085, 0.6405922646819646, -1.6978769262559434],
        "wclm-ml": (
            [0.4508885946313766, 0.3787916869208064],
            [8.25763477196386e-05, -6.0594021293037344e-05, 8.227699416731085e-05],
        ),
    },
    "behind": {
        "wclm": (
            [-0.5374742182860812, -0.6388235569075768],
            [0.0002288101674665953, -0.00012099101663204381, 0.0001670488593182255],
        ),
        "polar": (
            [1.197820354616918, 2.270247152892799],
            [0.00015118071943380208, -1.6722172476375433e-05, 0.00046259904005915804],
        ),
        "arras-siegwart": (
            [1.1976842145035658, 2.270258274500133],
            [0.0001506695185897007, -1.7031933677421073e-05, 0.0004631571584346897],
        ),
        "siadat": [-0.6438060689129511, 0.7651886993617015, -1.1976842145035658],
        "wclm-ml": (
            [-0.5364833806564218, 0.639108665098731],
            [0.00020919838113743486, 0.00010928225574237575, 0.00015160704931077256],
        ),
    },
}


def rays_on(distance: float, normal: float, low: float, high: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    angles = np.linspace(low, high, count)
    return distance / np.cos(angles - normal) + 0.02 * np.sin(37 * np.arange(count)), angles


def random_walls(count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(7)
    walls = []
    for _ in range(count):
        normal, size = rng.uniform(-np.pi, np.pi), rng.integers(5, 60)
        low, high = np.sort(rng.uniform(-1.2, 1.2, 2))
        angles = normal + np.linspace(low - 0.05, high + 0.05, size)
        walls.append((rng.uniform(0.5, 6) / np.cos(angles - normal) + rng.normal(0, 0.03, size), angles))
    return walls


def full(triangle: list[float]) -> np.ndarray:
    return np.array([[triangle[0], triangle[1]], [triangle[1], triangle[2]]])


def derivatives(name: str, ranges: np.ndarray, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return central differences of an estimator's own parameters in every range and bearing, (k, n) each."""
    step = 1e-6

    def moved(i: int, by_range: float, by_angle: float) -> np.ndarray:
        r, a = ranges.copy(), angles.copy()
        r[i] += by_range
        a[i] += by_angle
        return ESTIMATORS[name].fit(r, a, NOISE).parameters

    count = len(ranges)
    in_range = [(moved(i, step, 0) - moved(i, -step, 0)) / (2 * step) for i in range(count)]
    in_angle = [(moved(i, 0, step) - moved(i, 0, -step)) / (2 * step) for i in range(count)]
    return np.array(in_range).T, np.array(in_angle).T


@pytest.mark.parametrize("wall", WALLS)
def test_golden_lines(wall: str) -> None:
    rays, golden = rays_on(*WALLS[wall]), GOLDEN[wall]
    for name in ("wclm", "arras-siegwart", "wclm-ml"):
        fit = ESTIMATORS[name].fit(*rays, NOISE)
        np.testing.assert_allclose(fit.parameters, golden[name][0], rtol=1e-12)
        np.testing.assert_allclose(fit.parameter_covariance, full(golden[name][1]), rtol=1e-9)
    fit = wclm.fit(*rays, NOISE)
    sign = np.array([[1, -1], [-1, 1]])
    np.testing.assert_allclose(fit.covariance, sign * fit.parameter_covariance)
    polar, jacobian = polar_of_uv(fit.uv)
    np.testing.assert_allclose(polar, golden["polar"][0], rtol=1e-12)
    np.testing.assert_allclose(covariance_through(jacobian, fit.covariance), full(golden["polar"][1]), rtol=1e-9)
    np.testing.assert_allclose(siadat.fit(*rays, NOISE).parameters, golden["siadat"], rtol=1e-12)


@pytest.mark.parametrize("name", ["wclm", "arras-siegwart", "siadat"])
def test_covariance_equals_that_of_numeric_jacobian(name: str) -> None:
    for ranges, angles in random_walls(20):
        fit = ESTIMATORS[name].fit(ranges, angles, NOISE)
        in_range, in_angle = derivatives(name, ranges, angles)
        numeric = NOISE.sigma_range**2 * in_range @ in_range.T + NOISE.sigma_bearing**2 * in_angle @ in_angle.T
        np.testing.assert_allclose(fit.parameter_covariance, numeric, atol=1e-6 * np.abs(numeric).max())


def paper_jacobian(ranges: np.ndarray, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives (2, n) of (x_Q, y_Q) in ranges and in bearings by eqs. (23)-(25); means are weighted."""
    x, y, share = ranges * np.cos(angles), ranges * np.sin(angles), ranges**-2 / np.sum(ranges**-2)
    x1, y1, x2, y2, xy = (np.sum(share * f) for f in (x, y, x * x, y * y, x * y))
    m = x2 * y2 - xy**2
    xq, yq = wclm.fit(ranges, angles, NOISE).parameters
    r = 1 - (2 * x * xq - 2 * y * yq)
    a, b = x * y2 - y * xy, y * x2 - x * xy
    c = r * (y * y2 + x * xy) + ranges**2 * y1
    d = r * (x * x2 + y * xy) + ranges**2 * x1
    return share / (m * ranges) * np.array([-a, b]), -share / m * np.array([c, d])


def test_derivatives_of_the_paper_are_correct() -> None:
    for ranges, angles in random_walls(20):
        in_range, in_angle = paper_jacobian(ranges, angles)
        numeric_range, numeric_angle = derivatives("wclm", ranges, angles)
        np.testing.assert_allclose(in_range, numeric_range, atol=1e-6 * np.abs(numeric_range).max())
        np.testing.assert_allclose(in_angle, numeric_angle, atol=1e-6 * np.abs(numeric_angle).max())
        covariance = NOISE.sigma_range**2 * in_range @ in_range.T + NOISE.sigma_bearing**2 * in_angle @ in_angle.T
        fitted = wclm.fit(ranges, angles, NOISE).parameter_covariance
        np.testing.assert_allclose(fitted, covariance, rtol=1e-9)
        # rotating the scan rotates B = x_Q - i y_Q; scaling all ranges scales it inversely
        xq, yq = wclm.fit(ranges, angles, NOISE).parameters
        b = xq - 1j * yq
        complex_range, complex_angle = in_range[0] - 1j * in_range[1], in_angle[0] - 1j * in_angle[1]
        assert np.sum(complex_angle) == pytest.approx(1j * b, rel=1e-9)
        assert np.sum(ranges * complex_range) == pytest.approx(-b, rel=1e-9)


def test_fit_solves_the_weighted_normal_equations() -> None:
    for ranges, angles in random_walls(20):
        x, y, w = ranges * np.cos(angles), ranges * np.sin(angles), ranges**-2
        sx, sy, sxx, syy, sxy = (np.sum(w * f) for f in (x, y, x * x, y * y, x * y))
        delta = sxx * syy - sxy**2
        expected = [(sx * syy - sy * sxy) / delta, (sx * sxy - sy * sxx) / delta]  # eqs. (18), (19)
        np.testing.assert_allclose(wclm.fit(ranges, angles, NOISE).parameters, expected, rtol=1e-9)


def test_single_sums_equal_double_sums() -> None:
    for ranges, angles in random_walls(20):
        single = arras_siegwart.fit(ranges, angles, NOISE)
        double = arras_siegwart.fit(ranges, angles, NOISE, sums="double")
        np.testing.assert_allclose(double.parameters, single.parameters, rtol=1e-10)
        np.testing.assert_allclose(double.parameter_covariance, single.parameter_covariance, rtol=1e-8)


def test_siadat_equals_arras_siegwart_for_equal_weights() -> None:
    for ranges, angles in random_walls(20):
        one, other = arras_siegwart.fit(ranges, angles, NOISE), siadat.fit(ranges, angles, NOISE)
        np.testing.assert_allclose(other.uv, one.uv, rtol=1e-9)
        np.testing.assert_allclose(other.covariance, one.covariance, rtol=1e-8)
        assert np.linalg.matrix_rank(other.parameter_covariance, tol=1e-9 * other.parameter_covariance.max()) == 2


@pytest.mark.parametrize("name", ESTIMATORS)
def test_fits_are_equivariant_to_rotation_and_scale(name: str) -> None:
    for ranges, angles in random_walls(5):
        for turn in (-2.0, 0.4, 3.0):
            fit, turned = (ESTIMATORS[name].fit(ranges, angles + by, NOISE) for by in (0.0, turn))
            c, s = np.cos(turn), np.sin(turn)
            rotation = np.array([[c, -s], [s, c]])
            np.testing.assert_allclose(turned.uv, rotation @ fit.uv, rtol=1e-9)
            np.testing.assert_allclose(turned.covariance, rotation @ fit.covariance @ rotation.T, rtol=1e-6)
        larger = ESTIMATORS[name].fit(3 * ranges, angles, Noise(3 * NOISE.sigma_range, NOISE.sigma_bearing))
        np.testing.assert_allclose(3 * larger.uv, fit.uv, rtol=1e-9)
        np.testing.assert_allclose(9 * larger.covariance, fit.covariance, rtol=1e-6)


@pytest.mark.parametrize("name", ESTIMATORS)
def test_exact_rays_determine_the_exact_line(name: str) -> None:
    angles = np.linspace(-0.6, 0.9, 40)
    fit = ESTIMATORS[name].fit(2.5 / np.cos(angles - 0.3), angles, Noise(1e-9, 1e-9))
    np.testing.assert_allclose(fit.uv, np.array([np.cos(0.3), np.sin(0.3)]) / 2.5, rtol=1e-9)
    assert isinstance(fit, LineFit)


def test_unequal_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match="one length"):
        wclm.fit(np.ones(3), np.ones(4), NOISE)


# Distance (m), bearings from the normal (degrees), number of rays, range noise (m): short, far, oblique, grazing, near.
CASES = [
    (4.0, -11, 11, 58, 0.05),
    (1.5, -45, 45, 230, 0.05),
    (1.5, 40, 60, 52, 0.01),
    (1.0, 70, 85, 39, 0.01),
    (0.5, -70, 70, 358, 0.05),
    (6.0, 30, 34, 10, 0.01),
]


@pytest.mark.parametrize("case", CASES)
def test_maximum_likelihood_covariance_is_consistent(case: tuple[float, float, float, int, float]) -> None:
    """The mean of the squared normalised error over 1500 trials is 2, with a standard error of 0.05."""
    distance, low, high, count, sigma_range = case
    rng, noise = np.random.default_rng(11), Noise(sigma_range, np.radians(0.1955))
    angles = np.radians(np.linspace(low, high, count))
    truth = np.array([1 / distance, 0.0])
    total, trials = 0.0, 1500
    for _ in range(trials):
        bearings = angles + rng.normal(0, noise.sigma_bearing, count)
        ranges = distance / np.cos(bearings) + rng.normal(0, sigma_range, count)
        fit = wclm.fit_maximum_likelihood(ranges, angles, noise)
        error = fit.uv - truth
        total += error @ np.linalg.solve(fit.covariance, error)
    assert 1.8 < total / trials < 2.25


@pytest.mark.parametrize("case", [(2.0, 20, 70, 120), (0.5, -70, 70, 358)])
def test_covariance_is_consistent_if_the_weights_are_not(case: tuple[float, float, float, int]) -> None:
    """As before, with the weights of another noise."""
    distance, low, high, count = case
    rng, weights, noise = np.random.default_rng(13), Noise(0.01, np.radians(0.05)), Noise(0.008, np.radians(0.4))
    angles = np.radians(np.linspace(low, high, count))
    cos, sin = np.cos(angles), np.sin(angles)
    truth = np.array([1 / distance, 0.0])
    total, trials = 0.0, 1500
    for _ in range(trials):
        bearings = angles + rng.normal(0, noise.sigma_bearing, count)
        inverse = 1.0 / (distance / np.cos(bearings) + rng.normal(0, noise.sigma_range, count))
        u, v, cuu, cuv, cvv, _, _ = wclm.reweighted(
            inverse,
            cos,
            sin,
            *truth,
            weights.sigma_range,
            weights.sigma_bearing,
            noise.sigma_range,
            noise.sigma_bearing,
            np.inf,
        )
        error = np.array([u, v]) - truth
        total += error @ np.linalg.solve([[cuu, cuv], [cuv, cvv]], error)
    assert 1.8 < total / trials < 2.25


def test_covariance_of_the_paper_is_consistent_for_distant_walls() -> None:
    rng, trials, total = np.random.default_rng(12), 1500, 0.0
    angles, truth = np.radians(np.linspace(-11, 11, 58)), np.array([0.25, 0.0])
    for _ in range(trials):
        ranges = 4.0 / np.cos(angles + rng.normal(0, NOISE.sigma_bearing, 58)) + rng.normal(0, 0.05, 58)
        fit = wclm.fit(ranges, angles, NOISE)
        error = fit.uv - truth
        total += error @ np.linalg.solve(fit.covariance, error)
    assert 1.8 < total / trials < 2.2
