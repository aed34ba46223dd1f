"""Loop closures that a person confirms or forbids in a finished session."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from drivers import se2
from drivers.elapsed import elapsed

from ...errors import MapError
from ...graph.factors import Factor, FactorKind
from ...io.sessions import StoredSession
from ...io.sessions.corrections import LoopForbidding, Place, PlaceClosing, ProposedClosing
from ...loop_closure.closing import moving_loops, pull_together
from ...loop_closure.decision import LoopDecision
from ...loop_closure.look import Look
from ...loop_closure.loop_status import LoopStatus
from ...loop_closure.submap_search import REVISIT_GAP, SUBMAP_LENGTH, SubmapMatch
from ...mapping.part_gauge import join_groups, motion_to_part, return_to_odometry
from ...mapping.pass_separation import Pass, separate_pass
from ...reporting.run_statistics import loop_row
from .detours import direct_motions, is_detour, without_detours
from .joins import Separation, separation_of
from .place_match import match_places

MAX_TIME_DIFFERENCE = 5.0
"""Seconds between a stated stamp and the nearest keyframe: while the robot stands still, there is none."""


class LoopCorrector:
    """Corrections of the loop closures of a session, whose map has converged before each of them.

    history  scans of the session; after a closure was forbidden, relative to keyframes of their own pass
    decided  loop decisions by the corrections, as in summary.json
    """

    def __init__(self, session: StoredSession) -> None:
        self._session, self._state = session, session.slam_state
        self.history, self.decided = session.scan_history(), list[dict[str, Any]]()
        self._segments = [self.history.scans[row].features.segments for row in self.history.keyframes.tolist()]

    def close(self, correction: ProposedClosing | PlaceClosing, ties: Collection[tuple[int, int]]) -> dict[str, Any]:
        """Close a loop; return how far the robot moves, and how well the scans fit. Raises MapError if they do not.

        ties  walls (kept, absorbed) that a person has tied, which stay one
        """
        candidate, old, keyframe, motion = self._stated(correction)
        state, mapper = self._state, self._state.mapper
        look, match = match_places(state, old, keyframe, motion)
        deviations = float(np.sqrt(look.squared_distance(old, match.pose)))
        decision = self._confirmed(candidate, old, keyframe, look, match)
        temporary = moving_loops(decision)
        if decision.joins:
            recent = mapper.landmarks.parts.connected(mapper.landmarks.walls.rows["last_seen"], keyframe)
            join_groups(mapper, old, keyframe, decision.correction)
            state.joins.clear()
        else:
            recent = separate_pass(mapper, self._pass(decision.since, keyframe), self._segments, ties=ties)
        mapper.graph.add_matches(temporary)
        closed = pull_together(mapper, decision, recent, temporary)
        if closed.status is not LoopStatus.ACCEPTED:
            raise MapError(f"keyframes {old} and {keyframe} are not one place by the other loop closures")
        state.local_field.link(old, keyframe)
        closed = replace(closed, shift=_distance(mapper.keyframe_poses[keyframe], look.pose))
        self._store(loop_row(state.keyframe_stamps[keyframe], closed))
        return {
            "keyframe": keyframe,
            "old": old,
            "shift": closed.shift,
            "deviations": deviations,
            "fit": match.fit,
            "known": match.known,
            "merged": len(closed.merged),
        }

    def _confirmed(self, candidate: int, old: int, keyframe: int, look: Look, match: SubmapMatch) -> LoopDecision:
        """Return the decision that a loop is closed, as the look at the old place has matched it."""
        parts, correction = self._state.mapper.landmarks.parts, look.motion(old, match.pose)
        return LoopDecision(
            candidate=candidate,
            keyframe=keyframe,
            old=old,
            motion=se2.between(look.pose, se2.compose(correction, look.pose)),
            correction=correction,
            status=LoopStatus.CONFIRMED,
            reason="closed by hand",
            matches=(look.loop_match(old, match),),
            runner_up=0.0,
            contradicted=0.0,
            checks=(),
            since=look.keyframe_at(look.travelled - SUBMAP_LENGTH),
            compared=look.compared_points(old),
            joins=parts.group(old) != parts.group(keyframe),
        )

    def forbid(self, correction: LoopForbidding, ties: Collection[tuple[int, int]]) -> dict[str, Any]:
        """Remove a closure and what rests on it; return how far the robot moves.

        ties  walls (kept, absorbed) that a person has tied: they stay one wall

        Raises MapError if the loop is not closed, or if another loop has to be forbidden first.
        """
        mapper, row = self._state.mapper, self._row(correction.loop)
        if row["status"] != LoopStatus.ACCEPTED:
            raise MapError(f"loop {correction.loop} cannot be forbidden: it is {row['status']}")
        keyframe, old = int(row["keyframe"]), int(row["old"])
        before = mapper.keyframe_poses[keyframe]
        parted = separation_of(mapper.landmarks.parts, self._session.loop_decisions, correction.loop)
        if parted is not None:
            self._separate_parts(parted, ties)
            for number in sorted(parted.resting):
                reason = f"rested on loop {correction.loop}, which is forbidden by hand"
                self._store({**self._row(number), "status": LoopStatus.FORBIDDEN, "reason": reason})
        else:
            factors = self._loop_factors(after=self._closed_before(keyframe), until=keyframe)
            if not factors:
                raise MapError(f"loop {correction.loop} cannot be forbidden: the graph has no factor of it")
            travelled = np.asarray(mapper.travelled)
            first = min(factor.second for factor in factors)
            one = self._pass(int(np.searchsorted(travelled, travelled[first] - SUBMAP_LENGTH)), keyframe)
            merged = _merged_after(mapper.graph.solver.sorted_factors(), keyframe)
            self._separate(one, ties, factors, merged)
        self._store({**row, "status": LoopStatus.FORBIDDEN, "reason": "forbidden by hand"})
        shift = _distance(mapper.keyframe_poses[keyframe], before)
        return {"keyframe": keyframe, "old": old, "shift": shift, "separated": parted is not None}

    def _separate_parts(self, parted: Separation, ties: Collection[tuple[int, int]]) -> None:
        """Separate parts of the map from earlier parts, and move them to where odometry leads."""
        mapper, parts = self._state.mapper, self._state.mapper.landmarks.parts
        first, end = ([*parts.firsts, mapper.keyframe_count][k] for k in (parted.part, parted.end))
        motion = motion_to_part(mapper, first)
        # While the sides are separated, the later one is held where it is.
        here = se2.between(mapper.keyframe_poses[motion.first], mapper.keyframe_poses[first])
        across = [f for f in self._loop_factors(after=first - 1, until=end - 1) if f.first < first]
        held = Factor(motion.kind, motion.first, first, here, motion.covariance)
        self._separate(Pass(range(first, end), 0.0), ties, [*across, motion], (), [held])
        parts.separate(parted.part)
        return_to_odometry(mapper, motion)
        self._state.joins.clear()

    def _separate(
        self,
        one: Pass,
        ties: Collection[tuple[int, int]],
        removed: Sequence[Factor],
        merged: Sequence[tuple[int, int]],
        added: Sequence[Factor] = (),
    ) -> None:
        """Separate a pass from earlier ones, with factors removed and added; see `separate_pass`."""
        mapper, firsts = self._state.mapper, self._state.mapper.landmarks.parts.firsts
        # Odometry's motion to a part is all that is known of its place: it stays.
        motions = [f for f in mapper.graph.solver.sorted_factors() if f.second not in firsts]
        detours = [factor for factor in motions if is_detour(factor, one.keyframes)]
        direct = direct_motions(detours, self.history, self._state.odometry_model, one.keyframes)
        gone = {*removed, *detours}
        separate_pass(
            mapper,
            one,
            self._segments,
            ties=ties,
            merged=merged,
            remove=lambda factor: factor in gone,
            add=[*direct, *added],
        )
        self.history = without_detours(self.history, one.keyframes)
        self._state.local_field.unlink(one.keyframes)

    def _stated(self, correction: ProposedClosing | PlaceClosing) -> tuple[int, int, int, se2.Pose | None]:
        """Return number, old keyframe and keyframe of a closure, and the robot's motion if it was proposed."""
        if isinstance(correction, ProposedClosing):
            row = self._row(correction.loop)
            if row["status"] == LoopStatus.ACCEPTED:
                raise MapError(f"loop {correction.loop} is closed already")
            return correction.loop, int(row["old"]), int(row["keyframe"]), np.array(row["motion"])
        old, keyframe = sorted(self._keyframe(place) for place in correction.places)
        number = max((int(row["candidate"]) for row in self._session.loop_decisions), default=0) + 1
        return number, old, keyframe, None

    def _row(self, number: int) -> dict[str, Any]:
        """Return the latest row of a loop decision. Raises MapError if there is none, or several closures have it."""
        rows = [dict(row) for row in self._session.loop_decisions if row["candidate"] == number]
        if not rows:
            numbers = ", ".join(str(k) for k in sorted({row["candidate"] for row in self._session.loop_decisions}))
            raise MapError(f"there is no loop {number}: {f'the loops are {numbers}' if numbers else 'there are none'}")
        if len({(row["keyframe"], row["old"]) for row in rows}) > 1:
            merged = "as an earlier version has merged the sessions: merge them again"
            raise MapError(f"several loops have the number {number}, {merged}")
        return rows[-1]

    def _store(self, row: dict[str, Any]) -> None:
        """Replace the rows of a loop decision by one, or add it."""
        others = [one for one in self._session.loop_decisions if one["candidate"] != row["candidate"]]
        self._session.loop_decisions = [*others, row]
        self._state.loops.number_after(int(row["candidate"]))
        self.decided = [*(one for one in self.decided if one["candidate"] != row["candidate"]), row]

    def _keyframe(self, place: Place) -> int:
        """Return the keyframe of a place. Raises MapError if there is none."""
        stamps = np.array(self._state.keyframe_stamps)
        if place.keyframe is not None:
            if place.keyframe >= len(stamps):
                raise MapError(f"there is no keyframe {place.keyframe}: the session has {len(stamps)}")
            return place.keyframe
        assert place.stamp is not None
        stamp = self._session.stamp_as_read(place.stamp)
        gaps = np.abs(stamps - stamp)
        if gaps.min() > MAX_TIME_DIFFERENCE:
            since, nearest = elapsed(round(stamp - stamps[0])), int(gaps.argmin())
            raise MapError(
                f"{place.text}: there is no keyframe within {MAX_TIME_DIFFERENCE:.0f} s of that stamp, {since} after "
                f"the first one; the nearest is keyframe {nearest}, {gaps[nearest]:.0f} s away"
            )
        return int(gaps.argmin())

    def _closed_before(self, keyframe: int) -> int:
        """Return the keyframe of the last closure before that at a keyframe; -1 if there is none."""
        closed = [row["keyframe"] for row in self._session.loop_decisions if row["status"] == LoopStatus.ACCEPTED]
        return max((int(other) for other in closed if other < keyframe), default=-1)

    def _loop_factors(self, after: int, until: int) -> list[Factor]:
        """Return the factors of closures by matches of keyframes after one, up to another."""
        factors = self._state.mapper.graph.matches()
        return [f for f in factors if f.kind is FactorKind.LOOP and after < f.second <= until]

    def _pass(self, since: int, keyframe: int) -> Pass:
        """Return the pass from `since` to the keyframe of a closure, and on to the next closure."""
        count = self._state.mapper.keyframe_count
        later = self._loop_factors(after=keyframe, until=count)
        return Pass(range(since, min((f.second for f in later), default=count)), REVISIT_GAP)


def _merged_after(factors: Sequence[Factor], keyframe: int) -> list[tuple[int, int]]:
    """Return the walls (kept, absorbed) that were merged after a keyframe was added.

    factors  of the graph, in the order in which they were added
    """
    to_keyframe = (factor.kind is FactorKind.ODOMETRY and factor.second == keyframe for factor in factors)
    added = next((row for row, found in enumerate(to_keyframe) if found), 0)
    return [(f.first, f.second) for f in factors[added:] if f.kind is FactorKind.WALL_EQUALITY]


def _distance(pose: se2.Pose, other: se2.Pose) -> float:
    """Return the metres between two poses."""
    return float(np.hypot(*(pose - other)[:2]))
