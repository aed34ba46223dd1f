"""Extractor: robust to any input, equivariant, deterministic, and adapting the range noise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from features import Extractor, Features, LearnedNoise, Noise
from features.kernel import TRIMMED_RAYS
from features.running_noise import given_noise

NOISE = Noise(0.01, 0.001)
GIVEN = given_noise(NOISE)


def extract(ranges: np.ndarray, angles: np.ndarray, noise: Noise = NOISE, **options: object) -> Features:
    return Extractor(noise, adapt_noise=False, **options).extract(ranges, angles)


def square_room(angles: np.ndarray, noise: float = 0.01, seed: int = 0) -> np.ndarray:
    """Return ranges in a room of 6 m by 4 m with the lidar at (0.5, -0.3) from its centre."""
    c, s = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        x = np.where(c >= 0, 2.5, -3.5) / c
        y = np.where(s >= 0, 2.3, -1.7) / s
    return np.minimum(x, y) + np.random.default_rng(seed).normal(0, noise, len(angles))


def assert_valid(features: Features, beams: int) -> None:
    lines, corners = features.lines, features.corners
    for values in (lines.uv, lines.covariance, lines.start, lines.end, lines.chi2, corners.position):
        assert np.isfinite(values).all()
    assert np.isfinite(corners.covariance).all()
    assert ((lines.first >= 0) & (lines.first < beams) & (lines.last >= 0) & (lines.last < beams)).all()
    assert ((corners.lines >= 0) & (corners.lines < len(lines))).all()
    assert (lines.count >= 5).all()
    if len(lines):
        assert (np.linalg.eigvalsh(lines.covariance) > 0).all()
    assert lines.uv.shape == lines.start.shape == lines.end.shape == (len(lines), 2)
    assert corners.covariance.shape == (len(corners), 2, 2)


@pytest.mark.parametrize("beams", [0, 1, 2, 3, 4, 5, 6, 12])
@pytest.mark.parametrize("method", ["split", "tracking"])
def test_few_beams_are_accepted(beams: int, method: str) -> None:
    angles = np.linspace(-0.5, 0.5, beams)
    assert_valid(extract(2.0 / np.cos(angles), angles, method=method), beams)


anything = st.floats(allow_nan=True, allow_infinity=True, width=64)
plausible = st.floats(0.1, 20.0)


@settings(max_examples=150, deadline=None)
@given(
    st.integers(0, 60).flatmap(
        lambda n: st.tuples(
            hnp.arrays(np.float64, n, elements=st.one_of(anything, plausible)),
            hnp.arrays(np.float64, n, elements=st.one_of(anything, st.floats(-4, 4))),
        )
    ),
    st.booleans(),
    st.sampled_from(["split", "tracking"]),
)
def test_arbitrary_scans_give_valid_features(scan: tuple[np.ndarray, np.ndarray], ordered: bool, method: str) -> None:
    ranges, angles = scan
    assert_valid(extract(ranges, np.sort(angles) if ordered else angles, method=method), len(ranges))


@settings(max_examples=60, deadline=None)
@given(hnp.arrays(np.float64, 180, elements=st.floats(0.125, 20.0, width=16)))
def test_coarsely_quantised_scans_give_valid_features(ranges: np.ndarray) -> None:
    """With few different ranges rays coincide, walls are concentric and sums degenerate."""
    assert_valid(extract(ranges, np.linspace(-np.pi / 2, np.pi / 2, 180)), 180)


@settings(max_examples=40, deadline=None)
@given(hnp.arrays(bool, 360, elements=st.booleans()), st.sampled_from([np.nan, np.inf, -np.inf, 0.0, -1.0, 81.8]))
def test_lost_rays_are_ignored(lost: np.ndarray, value: float) -> None:
    angles = np.linspace(-np.pi, np.pi, 360, endpoint=False)
    ranges = square_room(angles)
    ranges[lost] = value
    features = extract(ranges, angles)
    assert_valid(features, 360)
    distances = 1 / np.hypot(*features.lines.uv.T)
    assert all(np.abs(np.array([2.5, 3.5, 2.3, 1.7]) - d).min() < 0.15 for d in distances)


@settings(max_examples=30, deadline=None)
@given(st.floats(-7, 7))
def test_rotating_the_bearings_rotates_the_features(turn: float) -> None:
    angles = np.linspace(-2.0, 2.0, 400)
    ranges = square_room(angles)
    plain, turned = extract(ranges, angles), extract(ranges, angles + turn)
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s], [s, c]])
    assert (plain.lines.first == turned.lines.first).all()
    np.testing.assert_allclose(turned.lines.uv, plain.lines.uv @ rotation.T, atol=1e-7)
    np.testing.assert_allclose(turned.corners.position, plain.corners.position @ rotation.T, atol=1e-6)
    np.testing.assert_allclose(
        turned.lines.covariance,
        rotation @ plain.lines.covariance @ rotation.T,
        atol=1e-6 * plain.lines.covariance.max(),
    )


@settings(max_examples=20, deadline=None)
@given(st.floats(0.5, 3.0))
def test_scaling_the_scan_scales_the_features(scale: float) -> None:
    angles = np.linspace(-2.0, 2.0, 400)
    ranges = square_room(angles)
    plain = extract(ranges, angles, roughness=0.01)
    larger = extract(
        scale * ranges,
        angles,
        Noise(scale * NOISE.sigma_range, NOISE.sigma_bearing),
        roughness=scale * 0.01,
        maximum_gap=scale * 0.4,
        minimum_length=scale * 0.25,
    )
    np.testing.assert_allclose(scale * larger.lines.uv, plain.lines.uv, atol=1e-7)
    np.testing.assert_allclose(larger.corners.position, scale * plain.corners.position, atol=1e-6)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 719))
def test_features_do_not_depend_on_the_start_of_the_revolution(start: int) -> None:
    angles = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    ranges = square_room(angles)
    plain = extract(ranges, angles)
    moved = extract(np.roll(ranges, -start), angles[start] + (angles - angles[0]))
    assert len(plain.lines) == len(moved.lines) == 4
    assert len(plain.corners) == len(moved.corners) == 4
    order = [int(np.hypot(*(moved.lines.uv - uv).T).argmin()) for uv in plain.lines.uv]
    np.testing.assert_allclose(moved.lines.uv[order], plain.lines.uv, atol=1e-9)
    assert ((moved.lines.first[order] + start) % 720 == plain.lines.first).all()
    assert ((moved.lines.last[order] + start) % 720 == plain.lines.last).all()


def test_a_lidar_with_fifty_beams_shows_walls_unless_every_second_beam_is_lost() -> None:
    angles = np.linspace(-np.pi, np.pi, 50, endpoint=False)
    ranges = square_room(angles)
    found = extract(ranges, angles).lines
    distances = np.sort(1.0 / np.hypot(*found.uv.T))
    np.testing.assert_allclose(distances, [1.7, 2.3, 2.5, 3.5], atol=0.05)
    assert len(extract(np.where(np.arange(50) % 2, np.nan, ranges), angles).lines) == 0


def test_beams_beyond_one_revolution_are_ignored() -> None:
    angles = -np.pi + 2 * np.pi / 720 * np.arange(760)
    ranges = square_room(angles, noise=0.0)
    features = extract(ranges, angles)
    assert len(features.lines) == len(features.corners) == 4
    assert features.lines.count.sum() == 720 - 4 * 2 * TRIMMED_RAYS


def test_number_of_beams_may_change() -> None:
    extractor = Extractor(NOISE, adapt_noise=False)
    for beams in (360, 1100, 180, 920, 360):
        angles = np.linspace(-np.pi, np.pi, beams, endpoint=False)
        assert len(extractor.extract(square_room(angles), angles).lines) == 4


def test_any_kind_of_array_is_accepted() -> None:
    angles = np.linspace(-np.pi, np.pi, 360, endpoint=False)
    ranges = square_room(angles)
    expected = extract(ranges, angles)
    read_only = ranges.copy()
    read_only.flags.writeable = False
    strided = np.repeat(ranges, 2)[::2]
    for same in (read_only, strided, ranges.tolist()):
        np.testing.assert_array_equal(extract(same, angles).lines.uv, expected.lines.uv)
    assert len(extract(ranges.astype(np.float32), angles).lines) == 4


def test_features_are_not_overwritten_by_the_next_scan() -> None:
    extractor = Extractor(NOISE, adapt_noise=False)
    angles = np.linspace(-np.pi, np.pi, 360, endpoint=False)
    features = extractor.extract(square_room(angles), angles)
    before = features.lines.uv.copy(), features.corners.position.copy()
    extractor.extract(3 * square_room(angles, seed=5), angles)
    np.testing.assert_array_equal(features.lines.uv, before[0])
    np.testing.assert_array_equal(features.corners.position, before[1])


@pytest.mark.parametrize("sigma_bearing", [0.02, 0.04, 0.0999])
def test_a_bearing_noise_far_above_the_true_one_leaves_no_line_without_a_covariance(
    simulate: Callable[..., object], sigma_bearing: float
) -> None:
    for adapt_noise in (False, True):
        extractor = Extractor(Noise(0.01, sigma_bearing), adapt_noise=adapt_noise)
        for seed in range(20):
            scan = simulate(seed, beams=500, sigma_range=0.01, sigma_bearing=np.radians(0.05))
            assert_valid(extractor.extract(scan.ranges, scan.angles), 500)


@pytest.mark.parametrize("given_sigma", [0.002, 0.01, 0.05])
@pytest.mark.parametrize("true_sigma", [0.005, 0.01, 0.03])
def test_range_noise_is_estimated(simulate: Callable[..., object], given_sigma: float, true_sigma: float) -> None:
    extractor = Extractor(Noise(given_sigma, np.radians(0.05)))
    for seed in range(100):
        scan = simulate(seed, beams=500, sigma_range=true_sigma, sigma_bearing=np.radians(0.05), outliers=0.01)
        features = extractor.extract(scan.ranges, scan.angles)
    assert features.noise.sigma_range == pytest.approx(true_sigma, rel=0.15)
    assert extractor.noise.sigma_bearing < np.radians(0.1)


@pytest.mark.parametrize("given_degrees", [0.05, 0.5])
@pytest.mark.parametrize("true_degrees", [0.2, pytest.param(0.4, marks=pytest.mark.slow)])
def test_bearing_noise_is_estimated(simulate: Callable[..., object], given_degrees: float, true_degrees: float) -> None:
    extractor = Extractor(Noise(0.01, np.radians(given_degrees)))
    for seed in range(150):
        scan = simulate(seed, beams=500, sigma_range=0.01, sigma_bearing=np.radians(true_degrees), outliers=0.01)
        features = extractor.extract(scan.ranges, scan.angles)
    assert features.noise.sigma_bearing == pytest.approx(np.radians(true_degrees), rel=0.15)
    assert features.noise.sigma_range == pytest.approx(0.01, rel=0.1)


def test_walls_that_face_the_lidar_do_not_determine_the_bearing_noise() -> None:
    angles, random = np.radians(np.linspace(-12.0, 12.0, 97)), np.random.default_rng(4)
    extractor = Extractor(Noise(0.01, np.radians(0.05)))
    for _ in range(100):
        extractor.extract(4.0 / np.cos(angles) + random.normal(0.0, 0.03, len(angles)), angles)
    assert extractor.noise.sigma_range == pytest.approx(0.03, rel=0.1)
    assert extractor.noise.sigma_bearing == pytest.approx(np.radians(0.05), rel=0.1)


@pytest.mark.parametrize("given_sigma", [0.005, 0.01, 0.05])
def test_the_first_scan_settles_most_of_a_wrong_noise(simulate: Callable[..., object], given_sigma: float) -> None:
    remaining = []
    for seed in range(20):
        scan = simulate(seed, beams=500, sigma_range=0.02, sigma_bearing=np.radians(0.05))
        settled, once = (Extractor(Noise(given_sigma, np.radians(0.05))) for _ in range(2))
        assert settled.settle_noise(scan.ranges, scan.angles)
        once.extract(scan.ranges, scan.angles)
        remaining.append([np.log(each.noise.sigma_range / 0.02) for each in (settled, once)])
    by_settling, by_extraction = np.abs(np.median(remaining, axis=0))
    assert by_settling < 0.75 * by_extraction


def test_the_first_scan_settles_most_of_a_wrong_bearing_noise(simulate: Callable[..., object]) -> None:
    settled = []
    for seed in range(20):
        scan = simulate(seed, beams=500, sigma_range=0.005, sigma_bearing=np.radians(0.4))
        extractor = Extractor(Noise(0.005, np.radians(0.05)))
        assert extractor.settle_noise(scan.ranges, scan.angles)
        settled.append(extractor.noise.sigma_bearing)
    assert np.median(settled) == pytest.approx(np.radians(0.4), rel=0.5)


def test_the_learned_noise_changes_covariances_only(simulate: Callable[..., object]) -> None:
    scan = simulate(3, beams=500, sigma_range=0.01, sigma_bearing=np.radians(0.2))
    low, high = (
        Extractor(NOISE, learned=LearnedNoise(0.01, np.radians(degrees), 0.01)).extract(scan.ranges, scan.angles).lines
        for degrees in (0.05, 0.4)
    )
    np.testing.assert_array_equal(low.uv, high.uv)
    np.testing.assert_array_equal(low.first, high.first)
    np.testing.assert_array_equal(low.chi2, high.chi2)
    assert (np.linalg.eigvalsh(high.covariance - low.covariance) > 0.0).all()


@pytest.mark.parametrize("scans", [3, 40])
def test_learning_goes_on_where_another_extractor_has_left_it(simulate: Callable[..., object], scans: int) -> None:
    first, second = (
        [simulate(seed, beams=180, sigma_range=0.02, sigma_bearing=np.radians(0.2)) for seed in seeds]
        for seeds in (range(scans), range(scans, scans + 20))
    )
    whole = Extractor(NOISE)
    for scan in first:
        whole.extract(scan.ranges, scan.angles)
    continued = Extractor(NOISE, learned=whole.noise)
    for scan in second:
        for extractor in (whole, continued):
            extractor.extract(scan.ranges, scan.angles)
    assert continued.noise == whole.noise


def test_a_scan_without_lines_settles_nothing(simulate: Callable[..., object]) -> None:
    angles, extractor = np.linspace(-np.pi, np.pi, 360, endpoint=False), Extractor(NOISE)
    assert not extractor.settle_noise(np.full(360, np.nan), angles)
    assert extractor.noise == GIVEN
    scan = simulate(0, beams=500)
    fixed = Extractor(NOISE, adapt_noise=False)
    assert fixed.settle_noise(scan.ranges, scan.angles)
    assert fixed.noise == GIVEN


def test_quantisation_is_part_of_the_estimated_noise(simulate: Callable[..., object]) -> None:
    extractor = Extractor(Noise(0.02, 0.0005))
    for seed in range(100):
        scan = simulate(seed, beams=500, sigma_range=0.002, sigma_bearing=0.0005)
        extractor.extract(np.round(scan.ranges, 2), scan.angles)
    assert 0.0025 < extractor.noise.sigma_range < 0.005  # 1 cm / sqrt(12) = 2.9 mm


def test_estimated_noise_has_a_lower_limit(simulate: Callable[..., object]) -> None:
    extractor = Extractor(NOISE)
    for seed in range(200):
        scan = simulate(seed, beams=500, sigma_range=0.0, sigma_bearing=0.0)
        features = extractor.extract(scan.ranges, scan.angles)
        assert_valid(features, 500)
    assert 0.002 <= extractor.noise.sigma_range < 0.004


def test_noise_is_constant_without_adaptation() -> None:
    extractor = Extractor(NOISE, adapt_noise=False)
    angles = np.linspace(-1, 1, 200)
    assert extractor.extract(square_room(angles, noise=0.03), angles).noise == GIVEN
    assert extractor.noise == GIVEN


def test_extraction_is_deterministic(simulate: Callable[..., object]) -> None:
    scans = [simulate(seed) for seed in range(5)]
    first, second = (
        [e.extract(scan.ranges, scan.angles) for scan in scans] for e in (Extractor(NOISE), Extractor(NOISE))
    )
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.lines.uv, b.lines.uv)
        assert a.noise == b.noise


@pytest.mark.parametrize(
    "wrong",
    [{"estimator": "ransac"}, {"method": "magic"}, {"noise": Noise(0.0, 0.1)}, {"noise": Noise(float("nan"), 0.1)}],
)
def test_wrong_settings_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"no estimator|no method|noise"):
        Extractor(**({"noise": NOISE} | wrong))


def test_unequal_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match="10 ranges but 9 angles"):
        extract(np.ones(10), np.zeros(9))


def test_chords_of_curved_surfaces_can_be_left_out() -> None:
    """A straight wall that closes a round room stays; so do the corners between straight walls."""
    angles = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    ranges = np.minimum(3.0, 2.0 / np.maximum(np.cos(angles), 0.01)) + 0.004 * np.random.default_rng(1).normal(size=720)
    features = Extractor(Noise(0.004, 0.0005)).extract(ranges, angles)
    straight = features.without_chords()
    assert features.lines.curved.sum() > 4
    assert len(straight.lines) == len(features.lines) - features.lines.curved.sum()
    assert not straight.lines.curved.any()
    assert np.abs(straight.lines.start[:, 0] - 2.0).min() < 0.02
    assert straight.corners.lines.size == 0 or straight.corners.lines.max() < len(straight.lines)
