"""Verification of loop closure hypotheses: every check must pass; the first that fails is the reason for rejection."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from drivers import se2

from ..geometry.segments import Floats, Segments
from ..mapping.landmarks import Landmarks
from .occlusion import occluded_share
from .proposal import Hypothesis, are_distinct
from .recent_walls import ReferenceMap, WallSet

# Largest motion, as a multiple of the expected drift. The covariance check bounds the drift better, and alternatives
# are searched up to ALTERNATIVE_REACH. Origin: chosen; not measured.
MAX_DRIFT_RATIO = 1.4
# Least share of the recent wall length in the mapped area that must fall on reference walls.
# Origin: tuned on Intel, fr079, CSAIL.
MIN_OVERLAP_RATIO = 0.5
# The same of the walls that constrain any one direction. Origin: measured, on recordings: 2/3 to 4/5 for true places;
# less for wrong ones with moved furniture, where walls along one direction alone make a place look right.
MIN_DIRECTIONAL_RATIO = 0.65
# Walls that must match. Origin: tuned on Intel, fr079, CSAIL, together with MIN_MATCHED_LENGTH.
MIN_MATCHED_WALLS = 4
# Metres of wall that must fall on reference walls in addition to those of the null hypothesis.
# Origin: tuned on Intel, fr079, CSAIL.
MIN_GAIN = 3.0
# Metres of wall that must fall on reference walls. Origin: tuned on Intel, fr079, CSAIL.
MIN_MATCHED_LENGTH = 6.0
# Metres, largest standard deviation of the motion in any direction; parallel walls alone never reach it.
# Origin: chosen; not measured.
MAX_LOOP_SIGMA = 0.07
# Metres, a short motion: buildings do not repeat themselves so soon. If drift does not explain such a motion, walls
# were misassociated, which raises what the null hypothesis explains; relaxed limits apply then.
# Origin: chosen; not measured.
SHORT_MOTION = 1.0
# Radians, likewise. Origin: chosen; not measured.
SHORT_MOTION_TURN = np.radians(6.0)
# MIN_OVERLAP_RATIO and MIN_DIRECTIONAL_RATIO of a short motion. Origin: tuned on Intel, fr079, CSAIL.
RELAXED_OVERLAP_RATIO = 0.4
# MIN_GAIN of a short motion, metres. Origin: tuned on Intel, fr079, CSAIL.
RELAXED_GAIN = 1.5
# Largest squared Mahalanobis distance between a motion and the estimate.
# Origin: chi-square, 3 dof, 99.9 %, for standard deviations half as large again: wheel errors are not white noise.
MAX_SQUARED_MAHALANOBIS = 1.5**2 * 16.3
# Metres, metres, radians: standard deviations by which misassociated walls may have pulled the estimate, in addition
# to its covariance. Origin: chosen; not measured.
MISASSOCIATION_SIGMAS = np.array([0.25, 0.25, np.radians(3.0)])
# Largest share of the hypothesis's wall length that an alternative may explain; more makes the place ambiguous, unless
# the estimate excludes the alternative. Origin: tuned on Intel, fr079, CSAIL.
MAX_ALTERNATIVE_RATIO = 0.85
# The same of an alternative that agrees better with odometry than the hypothesis.
# Origin: tuned on simulated drives.
MAX_LIKELIER_ALTERNATIVE_RATIO = 0.70
# Largest share of the wall length seen that reference walls would have hidden; or the share of the null hypothesis,
# if that is larger, as doors open and furniture moves. Origin: chosen; not measured.
MAX_OCCLUDED_SHARE = 0.10


@dataclass(frozen=True, slots=True)
class Check:
    """Check of a hypothesis: a measured value and its gate, the least value if `at_least`, else the largest."""

    name: str
    value: float
    gate: float
    at_least: bool
    failure: str
    """Reason for rejection if the check fails."""

    @property
    def passed(self) -> bool:
        """True if the value keeps the gate."""
        return self.value >= self.gate if self.at_least else self.value <= self.gate


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """Result of verifying a hypothesis: the decision, its scores, and all checks in order.

    runner_up              wall length that the best alternative explains, relative to the hypothesis
    sigma                  standard deviation of the motion in its least certain direction, metres
    contradicted           share of the wall length seen that reference walls would have hidden
    beats_null_hypothesis  true if the hypothesis explains clearly more than the null hypothesis, accepted or not
    ambiguous              true if an alternative explains nearly as much
    relaxed                true if the relaxed limits of a short motion that drift does not explain were applied
    """

    accepted: bool
    reason: str
    overlap_ratio: float
    matches: int
    runner_up: float
    sigma: float
    contradicted: float
    beats_null_hypothesis: bool
    ambiguous: bool
    relaxed: bool
    checks: tuple[Check, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class VerificationContext:
    """Data that hypotheses are verified with.

    pose         of the robot in the map
    views        poses of the last keyframes, each with the segments seen from there
    uncertainty  returns the covariance (3, 3) of the pose relative to the old keyframe, in the robot's frame; it costs
                 more than all other data together
    """

    recent: WallSet
    reference: ReferenceMap
    landmarks: Landmarks
    pose: se2.Pose
    views: Sequence[tuple[se2.Pose, Segments]]
    uncertainty: Callable[[], Floats]


def verify(hypotheses: Sequence[Hypothesis], context: VerificationContext) -> Verdict:
    """Verify the second of several hypotheses; the first is the null hypothesis, the others are alternatives."""
    motion = robot_motion(hypotheses[1], context.pose)
    relaxed = is_short_motion(motion)
    gain, *fits = _check_fit(hypotheses, context, relaxed=relaxed)
    if relaxed and all(check.passed for check in (gain, *fits)) and not exceeds_drift(motion, context.uncertainty()):
        relaxed = False
        gain, *fits = _check_fit(hypotheses, context, relaxed=False)
    fitting = all(check.passed for check in (gain, *fits))
    alternatives = _check_alternatives(hypotheses, context, use_estimate=fitting and not relaxed)
    checks = [gain, *fits, *alternatives]
    if all(check.passed for check in checks):
        checks.append(check_against_estimate(motion, context.uncertainty()))
    reason = next((check.failure for check in checks if not check.passed), "")
    values = {check.name: check.value for check in checks}
    return Verdict(
        accepted=not reason,
        reason=reason or "all checks passed",
        overlap_ratio=values["overlap-ratio"],
        matches=int(values["walls"]),
        runner_up=values["alternative"],
        sigma=values["sigma"],
        contradicted=values["contradicted"],
        beats_null_hypothesis=gain.passed,
        ambiguous=not all(check.passed for check in alternatives),
        relaxed=relaxed,
        checks=tuple(checks),
    )


def _check_fit(hypotheses: Sequence[Hypothesis], context: VerificationContext, *, relaxed: bool) -> list[Check]:
    """Check a hypothesis against the observations; the first check is the gain over the null hypothesis."""
    null, best = hypotheses[:2]
    gain = best.length - null.length
    shift, turn, drift_ratio = _relative_to_drift(best, context.reference, context.pose)
    matches, sigma = _count_matches(best), _worst_sigma(best)
    contradicted, allowed = (
        occluded_share(some.motion, context.reference, context.landmarks, context.views) for some in (best, null)
    )
    min_overlap, min_gain = (RELAXED_OVERLAP_RATIO, RELAXED_GAIN) if relaxed else (MIN_OVERLAP_RATIO, MIN_GAIN)
    min_directional = RELAXED_OVERLAP_RATIO if relaxed else MIN_DIRECTIONAL_RATIO
    directional = best.min_directional_ratio
    return [
        Check("gain", gain, min_gain, True, f"{gain:.1f} m of wall more than without a motion < {min_gain:.1f} m"),
        Check(
            "drift", drift_ratio, MAX_DRIFT_RATIO, False,
            f"{shift:.1f} m and {np.degrees(turn):.0f} degrees exceed the expected drift",
        ),
        Check(
            "overlap-ratio", best.overlap_ratio, min_overlap, True,
            f"overlap ratio {best.overlap_ratio:.0%} < {min_overlap:.0%}",
        ),
        Check(
            "directional-ratio", directional, min_directional, True,
            f"overlap ratio {directional:.0%} < {min_directional:.0%} in one direction",
        ),
        Check(
            "length", best.length, MIN_MATCHED_LENGTH, True,
            f"{best.length:.1f} m of wall < {MIN_MATCHED_LENGTH:.0f} m",
        ),
        Check("walls", matches, MIN_MATCHED_WALLS, True, f"{matches} walls < {MIN_MATCHED_WALLS}"),
        Check("sigma", sigma, MAX_LOOP_SIGMA, False, f"standard deviation {sigma:.2f} m in one direction"),
        Check(
            "contradicted", contradicted, max(MAX_OCCLUDED_SHARE, allowed), False,
            f"{contradicted:.0%} of the walls were seen through walls of the map",
        ),
    ]  # fmt: skip


def _check_alternatives(
    hypotheses: Sequence[Hypothesis], context: VerificationContext, *, use_estimate: bool
) -> list[Check]:
    """Check that no alternative explains nearly as much, or less than that but agrees better with odometry.

    Alternatives outside the gate of the estimate are ignored if `use_estimate`. It is false for a short motion that
    drift does not explain, as the estimate is wrong then, and if the hypothesis fails anyway, to save the time.
    """
    best = hypotheses[1]
    others = [h for h in hypotheses if h is not best and are_distinct(h.motion, best.motion, context.pose)]
    ratios = [(_explained_ratio(other, best), other) for other in others]
    likelier = 0.0
    if use_estimate and any(ratio > MAX_LIKELIER_ALTERNATIVE_RATIO for ratio, _ in ratios):
        covariance = context.uncertainty() + np.diag(MISASSOCIATION_SIGMAS**2)
        own = _squared_mahalanobis(robot_motion(best, context.pose), covariance)
        distances = [_squared_mahalanobis(robot_motion(other, context.pose), covariance) for _, other in ratios]
        shares = [ratio for ratio, _ in ratios]
        likelier = max((share for share, far in zip(shares, distances, strict=True) if far <= own), default=0.0)
        ratios = [item for item, far in zip(ratios, distances, strict=True) if far <= MAX_SQUARED_MAHALANOBIS]
    largest = max((ratio for ratio, _ in ratios), default=0.0)
    explains = "an alternative explains"
    return [
        Check("alternative", largest, MAX_ALTERNATIVE_RATIO, False, f"{explains} {largest:.0%} as much"),
        Check(
            "likelier-alternative", likelier, MAX_LIKELIER_ALTERNATIVE_RATIO, False,
            f"{explains} {likelier:.0%} as much and agrees better with odometry",
        ),
    ]  # fmt: skip


def is_short_motion(motion: se2.Pose) -> bool:
    """True if a motion [x, y, heading] of the robot is too short to lead to a similar-looking place."""
    return bool(np.hypot(motion[0], motion[1]) < SHORT_MOTION and abs(motion[2]) < SHORT_MOTION_TURN)


def exceeds_drift(motion: se2.Pose, covariance: Floats) -> bool:
    """True if drift does not explain a motion; if the motion is right, walls were misassociated.

    motion      [x, y, heading] in the robot's frame
    covariance  (3, 3) of the robot's pose relative to the old keyframe, in the robot's frame
    """
    return _squared_mahalanobis(motion, covariance) > MAX_SQUARED_MAHALANOBIS


def check_against_estimate(motion: se2.Pose, covariance: Floats) -> Check:
    """Check that drift or misassociated walls explain a motion; the arguments are those of `exceeds_drift`.

    A place that fits, but that the estimate excludes, is a similar-looking other place.
    """
    deviations = float(np.sqrt(_squared_mahalanobis(motion, covariance + np.diag(MISASSOCIATION_SIGMAS**2))))
    failure = f"{deviations:.0f} standard deviations from the estimate"
    return Check("mahalanobis", deviations, float(np.sqrt(MAX_SQUARED_MAHALANOBIS)), False, failure)


def robot_motion(hypothesis: Hypothesis, pose: se2.Pose) -> se2.Pose:
    """Return the motion [x, y, heading] of the robot at `pose` under a hypothesis, in the robot's frame."""
    return se2.between(pose, se2.compose(hypothesis.motion, pose))


def _squared_mahalanobis(motion: se2.Pose, covariance: Floats) -> float:
    return float(motion @ np.linalg.solve(covariance, motion))


def _relative_to_drift(hypothesis: Hypothesis, reference: ReferenceMap, pose: se2.Pose) -> tuple[float, float, float]:
    """Return shift (metres) and turn (radians) of the robot, and the larger of their ratios to the expected drift."""
    moved = robot_motion(hypothesis, pose)
    shift, turn = float(np.hypot(moved[0], moved[1])), abs(float(moved[2]))
    matched = hypothesis.matches[hypothesis.matches >= 0]
    translation = reference.translation[matched].max(initial=1e-9)
    rotation = reference.rotation[matched].max(initial=1e-9)
    return shift, turn, max(shift / translation, turn / rotation)


def _explained_ratio(alternative: Hypothesis, best: Hypothesis) -> float:
    """Return how much an alternative explains relative to the best hypothesis.

    Near the end of the reference map a motion farther into it explains more wall without being more likely. So an
    alternative that determines the pose on its own is compared by overlap ratio as well, not only by length.
    """
    by_length = alternative.length / max(best.length, 1e-9)
    if (
        _count_matches(alternative) < MIN_MATCHED_WALLS
        or alternative.length < MIN_MATCHED_LENGTH
        or _worst_sigma(alternative) > MAX_LOOP_SIGMA
    ):
        return by_length
    return max(by_length, alternative.overlap_ratio / max(best.overlap_ratio, 1e-9))


def _count_matches(hypothesis: Hypothesis) -> int:
    return int((hypothesis.matches >= 0).sum())


def _worst_sigma(hypothesis: Hypothesis) -> float:
    """Return the standard deviation of the motion in its least certain direction, metres."""
    return float(np.sqrt(np.linalg.eigvalsh(np.linalg.inv(hypothesis.information)[:2, :2])[-1]))
