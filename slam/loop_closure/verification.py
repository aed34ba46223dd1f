"""Whether a place is the one it looks like. Every test must hold; the first that fails is the reason for refusing."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from drivers import se2

from ..geometry.segments import Floats, Segments
from ..mapping.landmarks import Landmarks
from .proposal import Hypothesis, distinct
from .recent_walls import ReferenceMap, WallSet

# Times as far as drift is expected to lead that a place may be: how far it can have led, the estimate's covariance says
# better. Other places are looked for farther away still.
FARTHEST = 1.4
LEAST_EXPLAINED = 0.5  # share of the wall length seen where the old map has been that must fall on old walls
# The same of the walls that tell of any one direction. Of true places on recordings two in three to four in five do; of
# wrong ones whose furniture was moved few, as walls along one direction only make them look right.
LEAST_IN_DIRECTION = 0.65
LEAST_MATCHES = 4  # walls
LEAST_GAIN = 3.0  # metres of wall that must fall on old walls more than if nothing moved
LEAST_LENGTH = 6.0  # metres of wall that must fall on old walls
WORST_SIGMA = 0.07  # metres: the motion must be determined in every direction, which parallel walls alone never do
# Of a motion so short less is asked where the estimate is astray: no building repeats itself so soon, and walls that
# have been taken for others keep what staying explains high.
NEAR, NEAR_TURN, NEAR_EXPLAINED, NEAR_GAIN = 1.0, np.radians(6.0), 0.4, 1.5  # metres, radians, share, metres of wall
# Squared Mahalanobis distance of a motion that the estimate allows: chi-square with three degrees of freedom exceeds
# 16.3 once in a thousand times; errors of wheels that are no noise count for half the deviation more.
MOST_UNEXPECTED = 1.5**2 * 16.3
# By how much walls that were taken for others may have pulled the estimate besides its uncertainty, metres and radians.
ASTRAY_SIGMAS = np.array([0.25, 0.25, np.radians(3.0)])
# A different motion that explains this share of what the best one does makes the place ambiguous, unless the estimate
# rules it out; less of it will do where odometry speaks for the other one rather.
RUNNER_UP, LIKELIER_RUNNER_UP = 0.85, 0.70
# Share of the wall length seen that could not have been seen through the old walls. Doors open and things are moved:
# what contradicts staying put as much says nothing against moving.
MOST_CONTRADICTED = 0.10
LOOKED_AT = (-0.8, 0.0, 0.8)  # of a segment, from its middle to its ends, where lines of sight end
SHORTENED = 0.3  # metres by which views end before what they saw, and by which old walls are shortened


@dataclass(frozen=True, slots=True)
class Test:
    """One of the tests of a hypothesis: what was measured, and the gate it had to be `at_least` or at most."""

    name: str
    value: float
    gate: float
    at_least: bool
    failing: str  # the reason for refusing, where it does not hold

    @property
    def passed(self) -> bool:
        """Whether it holds."""
        return self.value >= self.gate if self.at_least else self.value <= self.gate


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """What was decided on a hypothesis, the scores it was decided by, and all tests in their order.

    casts_doubt  whether the place explains clearly more than where the robot is believed to be, accepted or not
    ambiguous    whether another place is nearly as good
    near         whether less was asked of it, the motion being short and the estimate astray
    """

    accepted: bool
    reason: str
    overlap_ratio: float
    matches: int
    runner_up: float
    sigma: float
    contradicted: float
    casts_doubt: bool
    ambiguous: bool
    near: bool
    tests: tuple[Test, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class VerificationContext:
    """What hypotheses are judged by.

    pose         of the robot
    views        the last keyframes' poses, each with the segments seen from there
    uncertainty  gives the covariance (3, 3) of the pose relative to the old place, in the robot's frame; to ask for it
                 costs more than all else
    """

    recent: WallSet
    old: ReferenceMap
    landmarks: Landmarks
    pose: se2.Pose
    views: Sequence[tuple[se2.Pose, Segments]]
    uncertainty: Callable[[], Floats]


def verify(hypotheses: Sequence[Hypothesis], outlook: VerificationContext) -> Verdict:
    """Judge the second of several hypotheses by what was seen; the first is that nothing has to move."""
    motion = robot_motion(hypotheses[1], outlook.pose)
    near = is_near(motion)
    gain, *fits = _fit_tests(hypotheses, outlook, near=near)
    if near and all(test.passed for test in (gain, *fits)) and not is_astray(motion, outlook.uncertainty()):
        near = False
        gain, *fits = _fit_tests(hypotheses, outlook, near=False)
    fitting = all(test.passed for test in (gain, *fits))
    rivals = _rival_tests(hypotheses, outlook, by_estimate=fitting and not near)
    tests = [gain, *fits, *rivals]
    if all(test.passed for test in tests):
        tests.append(allowed_by_estimate(motion, outlook.uncertainty()))
    reason = next((test.failing for test in tests if not test.passed), "")
    values = {test.name: test.value for test in tests}
    return Verdict(
        accepted=not reason,
        reason=reason or "all tests passed",
        overlap_ratio=values["overlap_ratio"],
        matches=int(values["walls"]),
        runner_up=values["runner-up"],
        sigma=values["sigma"],
        contradicted=values["contradicted"],
        casts_doubt=gain.passed,
        ambiguous=not all(test.passed for test in rivals),
        near=near,
        tests=tuple(tests),
    )


def _fit_tests(hypotheses: Sequence[Hypothesis], outlook: VerificationContext, *, near: bool) -> list[Test]:
    """Whether the place fits what was seen; the first test is by how much better than staying. `near` asks less."""
    stay, best = hypotheses[:2]
    gain = best.length - stay.length
    shift, turn, part = _driftwise(best, outlook.old, outlook.pose)
    matches, sigma = _matches(best), _sigma(best)
    contradicted, allowed = (
        contradiction(some.motion, outlook.old, outlook.landmarks, outlook.views) for some in (best, stay)
    )
    least_explained, least_gain = (NEAR_EXPLAINED, NEAR_GAIN) if near else (LEAST_EXPLAINED, LEAST_GAIN)
    least_weakest = NEAR_EXPLAINED if near else LEAST_IN_DIRECTION
    weakest = f"explains {best.weakest:.0%} < {least_weakest:.0%} in one direction"
    drift = f"{shift:.1f} m and {np.degrees(turn):.0f} degrees are farther than drift leads"
    explains = f"explains {best.overlap_ratio:.0%} < {least_explained:.0%}"
    long_enough = f"{best.length:.1f} m of wall < {LEAST_LENGTH:.0f} m"
    better = f"{gain:.1f} m of wall more than staying < {least_gain:.1f} m"
    through = f"{contradicted:.0%} was seen through old walls"
    return [
        Test("gain", gain, least_gain, True, better),
        Test("drift", part, FARTHEST, False, drift),
        Test("overlap_ratio", best.overlap_ratio, least_explained, True, explains),
        Test("weakest", best.weakest, least_weakest, True, weakest),
        Test("length", best.length, LEAST_LENGTH, True, long_enough),
        Test("walls", matches, LEAST_MATCHES, True, f"{matches} walls < {LEAST_MATCHES}"),
        Test("sigma", sigma, WORST_SIGMA, False, f"one direction known to {sigma:.2f} m only"),
        Test("contradicted", contradicted, max(MOST_CONTRADICTED, allowed), False, through),
    ]


def _rival_tests(hypotheses: Sequence[Hypothesis], outlook: VerificationContext, *, by_estimate: bool) -> list[Test]:
    """Whether of another place nearly as much is explained; the less will do, if odometry speaks for that rather.

    A place that the estimate rules out is no rival, if it is asked: where a near motion shows it to be astray it has no
    say, and where the place does not fit the answer would not matter.
    """
    best = hypotheses[1]
    others = [h for h in hypotheses if h is not best and distinct(h.motion, best.motion, outlook.pose)]
    rivals = [(_rivalry(other, best), other) for other in others]
    likelier = 0.0
    if by_estimate and any(share > LIKELIER_RUNNER_UP for share, _ in rivals):
        loose = outlook.uncertainty() + np.diag(ASTRAY_SIGMAS**2)
        own = _unexpectedness(robot_motion(best, outlook.pose), loose)
        unexpected = [_unexpectedness(robot_motion(rival, outlook.pose), loose) for _, rival in rivals]
        shares = [share for share, _ in rivals]
        likelier = max((share for share, far in zip(shares, unexpected, strict=True) if far <= own), default=0.0)
        rivals = [rival for rival, far in zip(rivals, unexpected, strict=True) if far <= MOST_UNEXPECTED]
    runner_up = max((share for share, _ in rivals), default=0.0)
    explains = "another place explains"
    return [
        Test("runner-up", runner_up, RUNNER_UP, False, f"{explains} {runner_up:.0%} as much"),
        Test(
            "likelier-rival", likelier, LIKELIER_RUNNER_UP, False,
            f"{explains} {likelier:.0%} as much, and odometry speaks for it rather",
        ),
    ]  # fmt: skip


def is_near(motion: se2.Pose) -> bool:
    """Whether a motion [x, y, heading] in the robot's frame is too short to lead to a place that looks alike."""
    return bool(np.hypot(motion[0], motion[1]) < NEAR and abs(motion[2]) < NEAR_TURN)


def is_astray(motion: se2.Pose, covariance: Floats) -> bool:
    """Whether a motion, were it right, would show that walls were taken for others: drift does not explain it.

    `covariance` (3, 3) is that of the robot's pose relative to the old place, in the robot's frame.
    """
    return _unexpectedness(motion, covariance) > MOST_UNEXPECTED


def allowed_by_estimate(motion: se2.Pose, covariance: Floats) -> Test:
    """Whether drift, or walls that were taken for others, explain a motion, given as above.

    A place that looks right while the robot is known to be elsewhere is another one that looks alike.
    """
    deviations = float(np.sqrt(_unexpectedness(motion, covariance + np.diag(ASTRAY_SIGMAS**2))))
    failing = f"{deviations:.0f} standard deviations from the estimate"
    return Test("unexpected", deviations, float(np.sqrt(MOST_UNEXPECTED)), False, failing)


def robot_motion(hypothesis: Hypothesis, pose: se2.Pose) -> se2.Pose:
    """The motion [x, y, heading] of the robot at `pose` by a hypothesis, in its own frame."""
    return se2.between(pose, se2.compose(hypothesis.motion, pose))


def _unexpectedness(motion: se2.Pose, covariance: Floats) -> float:
    return float(motion @ np.linalg.solve(covariance, motion))


def _driftwise(hypothesis: Hypothesis, old: ReferenceMap, pose: se2.Pose) -> tuple[float, float, float]:
    """Metres and radians by which the robot would move, and how many times that is what drift is expected to do."""
    moved = robot_motion(hypothesis, pose)
    shift, turn = float(np.hypot(moved[0], moved[1])), abs(float(moved[2]))
    matched = hypothesis.matches[hypothesis.matches >= 0]
    translation, rotation = old.translation[matched].max(initial=1e-9), old.rotation[matched].max(initial=1e-9)
    return shift, turn, max(shift / translation, turn / rotation)


def _rivalry(rival: Hypothesis, best: Hypothesis) -> float:
    """How much another motion explains, relative to the best one.

    Where the old map ends, a motion farther into it explains more wall without being any truer. So one that determines
    where the robot is by itself is compared by the share it explains of what could be known there, too.
    """
    by_length = rival.length / max(best.length, 1e-9)
    if _matches(rival) < LEAST_MATCHES or rival.length < LEAST_LENGTH or _sigma(rival) > WORST_SIGMA:
        return by_length
    return max(by_length, rival.overlap_ratio / max(best.overlap_ratio, 1e-9))


def _matches(hypothesis: Hypothesis) -> int:
    return int((hypothesis.matches >= 0).sum())


def _sigma(hypothesis: Hypothesis) -> float:
    """Metres: how well the matched walls determine the motion, in the direction in which they do so worst."""
    return float(np.sqrt(np.linalg.eigvalsh(np.linalg.inv(hypothesis.information)[:2, :2])[-1]))


def contradiction(
    motion: se2.Pose, old: ReferenceMap, landmarks: Landmarks, views: Sequence[tuple[se2.Pose, Segments]]
) -> float:
    """Share of the wall length seen in `views` that old walls would have hidden, were the robot moved by `motion`."""
    eyes, targets, weights = _sight_lines(motion, views)
    walls = old.wall_set.walls[old.left]
    if not len(eyes) or not len(walls):
        return 0.0
    rows = landmarks.walls.rows[walls]
    crossings = _crossings(eyes, targets, rows["frame"], rows["low"] + SHORTENED, rows["high"] - SHORTENED)
    blocked = np.zeros(len(eyes), dtype=bool)
    for ray, row, at in crossings:
        blocked[ray] |= landmarks.is_covered(int(walls[row]), at)
    return float(weights[blocked].sum() / weights.sum())


@njit(cache=True)
def _crossings(eyes, targets, frames, lows, highs):  # type: ignore[no-untyped-def]
    """The lines of sight (row of `eyes`), the walls (row of `frames`) that they cross between their ends, and where."""
    found = []
    for row in range(len(frames)):
        x, y = frames[row, 0], frames[row, 1]
        c, s = math.cos(frames[row, 2]), math.sin(frames[row, 2])
        for ray in range(len(eyes)):
            ex, ey = eyes[ray, 0] - x, eyes[ray, 1] - y
            tx, ty = targets[ray, 0] - x, targets[ray, 1] - y
            eye_side, target_side = c * ey - s * ex, c * ty - s * tx
            if eye_side * target_side < 0.0:
                part = eye_side / (eye_side - target_side)
                at = c * (ex + part * (tx - ex)) + s * (ey + part * (ty - ey))
                if lows[row] < at < highs[row]:
                    found.append((ray, row, at))
    return found


def _sight_lines(motion: se2.Pose, views: Sequence[tuple[se2.Pose, Segments]]) -> tuple[Floats, Floats, Floats]:
    """Eyes (r, 2), targets (r, 2) a little before what was seen, and the wall length (r,) that each stands for."""
    if not views:
        return np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0)
    poses = se2.compose(motion, np.array([pose for pose, _ in views]))
    frames = np.concatenate([se2.compose(pose, seen.frame) for pose, (_, seen) in zip(poses, views, strict=True)])
    eyes = np.repeat(poses[:, :2], [len(segments) for _, segments in views], axis=0)
    halves = np.concatenate([segments.half_length for _, segments in views])
    along = np.column_stack([np.cos(frames[:, 2]), np.sin(frames[:, 2])])
    seen = np.concatenate([frames[:, :2] + part * halves[:, None] * along for part in LOOKED_AT])
    eyes, weights = np.tile(eyes, (len(LOOKED_AT), 1)), np.tile(halves, len(LOOKED_AT))
    distance = np.hypot(*(seen - eyes).T)
    shorter = np.maximum(0.0, 1.0 - SHORTENED / np.maximum(distance, 1e-9))
    return eyes, eyes + shorter[:, None] * (seen - eyes), weights
