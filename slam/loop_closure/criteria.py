"""Criteria of loop closure: which matches count, and when looks support a hypothesis enough to close its loop."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from drivers import se2
from features.normal_limits import NORMAL_LIMIT

from ..geometry.chi_square import chi_square_quantile
from ..geometry.pose_covariance import position_sigma
from ..geometry.significance import STRICT_GATE, SUPPORT_RATIO
from ..matching.offset_tiles import MAX_CORRECTED_SIGMA
from .decision import Check, LoopDecision
from .look import SEARCH_INTERVAL, Look
from .loop_hypothesis import LoopHypothesis
from .loop_status import LoopStatus
from .submap_search import MIN_SCREENING_FIT, SUBMAP_LENGTH, SubmapMatch, are_distinct

# Least fit of a match. Origin: definition, with less it is less likely than a place that was not seen.
MIN_LOOP_FIT = MIN_SCREENING_FIT
# Least share of the submap in space that the old place has seen. Origin: chosen, not measured.
MIN_KNOWN = 0.4
# Largest squared Mahalanobis distance of a motion with which a loop is closed. Places farther away are searched too:
# if one that looks alike is near, the right one may be there, as a rival. Origin: chi-square, 3 dof.
MAX_CLOSED_DISTANCE = chi_square_quantile(STRICT_GATE, 3)
# Names of the checks of the looks that support a hypothesis: their number, the metres over which they extend, how far
# apart the positions are that they show, and the share of looks that contradict it. Origin: definition.
SUPPORT, SPAN, EXTENT, CONTRADICTED = "support", "span", "extent", "contradicted"
# Looks that must support a hypothesis. Origin: definition, one proposes it, and another one tests it.
MIN_SUPPORT = 2
# Looks that must support a hypothesis that leads to another place, or contradict the estimate before it is in doubt.
# Origin: definition, so many that the first and the last one have no point in common.
MIN_INDEPENDENT = math.ceil(SUBMAP_LENGTH / SEARCH_INTERVAL) + 1


def fits(match: SubmapMatch) -> bool:
    """Return True if a match shows enough of what the old place has seen, and that fits."""
    return match.known >= MIN_KNOWN and match.fit >= MIN_LOOP_FIT


def is_determined(match: SubmapMatch) -> bool:
    """Return True if a match determines the position in every direction; along a bare corridor it does not."""
    return position_sigma(match.covariance) < MAX_CORRECTED_SIGMA


def admits_closure(look: Look, old: int, relative: se2.Pose) -> bool:
    """Return True if the estimate's uncertainty admits a closure by a pose of the look in that of an old place."""
    return look.squared_distance(old, relative) < MAX_CLOSED_DISTANCE


def differ(look: Look, motion: se2.Pose, other: se2.Pose) -> bool:
    """Return True if two motions in the map lead the robot to different places."""
    return are_distinct(se2.compose(motion, look.pose), se2.compose(other, look.pose))


def support_checks(hypothesis: LoopHypothesis, look: Look, against: int, *, joins: bool) -> tuple[Check, ...]:
    """Check that enough looks support a hypothesis, and that the uncertainty admits it if it leads elsewhere.

    Where the robot is, there may be another place that looks like the old one and is not mapped yet. It is mapped, and
    is a rival, once the robot has been as far away as its position may be wrong. So two of the positions that the looks
    show must be that far apart: a robot that drives into a room and out again does not see the next room. The first
    look shows the drive before it, too, up to the length of a submap. How far the position may be wrong is known best
    at the first look: all looks imply about the same motion, so the uncertainty that is added on the way between them
    does not matter.

    Furniture that was moved may look like another place in all looks that show it. So the looks must extend over the
    length of a submap as well if the hypothesis leads to another place, if the estimate is in doubt, or if parts of the
    map are joined, for which there is no estimate.

    look     the last one
    against  number of looks that contradict the hypothesis
    joins    true if it would join parts of the map
    """
    count, first, old = len(hypothesis.support), hypothesis.support[0], hypothesis.support[-1].old
    elsewhere = joins or look.uncertainty.doubted or differ(look, hypothesis.motion, np.zeros(3))
    least, span = (MIN_INDEPENDENT, SUBMAP_LENGTH) if elsewhere else (MIN_SUPPORT, 0.0)
    extent = look.extent_since(first.travelled - look.distance_shown_before(first))
    checks = [
        Check(SUPPORT, count, least, at_least=True),
        Check(SPAN, hypothesis.span, span, at_least=True),
        Check(EXTENT, extent, NORMAL_LIMIT * look.deviation_at(first), at_least=True),
        Check(CONTRADICTED, against / count, 1.0 / SUPPORT_RATIO, at_least=False),
    ]
    if elsewhere:
        deviations = np.sqrt(look.squared_distance(old, look.relative(old, hypothesis.motion)))
        checks.append(Check("mahalanobis", float(deviations), float(np.sqrt(MAX_CLOSED_DISTANCE)), at_least=False))
    return tuple(checks)


def qualifies(hypothesis: LoopHypothesis, checks: Sequence[Check], *, in_doubt: bool, ended: bool) -> bool:
    """Return True if the evidence of the drive may decide on a hypothesis: all checks pass that it cannot replace.

    If others fail, the evidence must also outweigh how much places of the map look alike, see
    `recognition.loop_evidence`. It replaces the number of looks where furniture was moved: looks show much of that and
    contradict each other, and only the drive as a whole tells it from the place. If the estimate is in doubt, the looks
    that contradict it extend over a submap, so the drive shows more than furniture, and two looks that agree suffice.
    They suffice at the end of the drive, too, as no look can follow. The evidence tells nothing about a place that
    looks like the old one and is not mapped: before the end the robot must have been as far away as its position may be
    wrong.

    checks    of `support_checks`
    in_doubt  true if at least MIN_INDEPENDENT looks contradict the estimate
    ended     true at the end of the drive
    """
    replaced = {SUPPORT, SPAN} if in_doubt or ended else set()
    replaced |= {CONTRADICTED} if in_doubt else set()
    replaced |= {EXTENT} if ended else set()
    return len(hypothesis.support) >= MIN_SUPPORT and all(check.passed or check.name in replaced for check in checks)


def prevails(hypothesis: LoopHypothesis, rival: LoopHypothesis) -> bool:
    """Return True if a hypothesis is clearly better supported than a rival.

    That is, if the last look does not support the rival, and few looks do at all; or if enough looks support the
    hypothesis and contradict the rival, and few do the opposite.
    """
    first, last = hypothesis.support[0].travelled, hypothesis.support[-1]
    supported_now = bool(rival.support) and rival.support[-1].keyframe == last.keyframe
    if not supported_now and len(hypothesis.support) >= SUPPORT_RATIO * rival.support_since(first):
        return True
    against = rival.discriminating_looks(hypothesis)
    return hypothesis.discriminating_looks(rival) >= SUPPORT_RATIO * max(1, against)


def confirm(
    look: Look,
    hypothesis: LoopHypothesis,
    reason: str,
    *,
    rival_support: int,
    contradictions: int,
    checks: tuple[Check, ...],
    since: int,
    joins: bool,
) -> LoopDecision:
    """Return the decision to close the loop of a hypothesis, or to join parts of the map if `joins`.

    look            from the last keyframe
    rival_support   number of looks that support its strongest rival
    contradictions  number of looks that contradict it
    since           first keyframe of the recent pass, or of the part that is joined
    """
    count, last = len(hypothesis.support), hypothesis.support[-1]
    return LoopDecision(
        0,
        look.last,
        last.old,
        se2.between(look.pose, se2.compose(hypothesis.motion, look.pose)),
        hypothesis.motion,
        LoopStatus.CONFIRMED,
        reason,
        tuple(hypothesis.support),
        rival_support / count,
        contradictions / (count + contradictions),
        checks,
        since,
        look.compared_points(last.old),
        joins=joins,
        doubted=look.uncertainty.doubted,
    )
