"""Process scans one by one: track, map, close loops on trial, and retract closures that later scans contradict.

If the robot loses its pose, a new part of the map begins at once, and the scans that fitted nowhere are processed again
in it. If the next scans fit in the earlier part after all, the new one is discarded. On a frozen map a new part is a
map on trial: when its place is recognised, it is discarded, and only the poses of its scans are kept.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from drivers import se2
from drivers.immutable import immutable
from drivers.messages import Odometry

from ..geometry.surroundings import INDOOR_RANGE
from ..localisation.tracking import TrackingResult
from ..loop_closure.decision import LoopDecision
from ..loop_closure.loop_status import LoopStatus
from ..mapping.mapper import Mapper
from ..preprocessing.preprocessor import ProcessedScan
from ..recognition.location import LOST, Expectation
from .closure_monitor import ClosureMonitor
from .displaced_loops import close_displaced_loops
from .earlier_part import EarlierPart
from .journal import Journal
from .loop_update import close_loop, search_last_loop
from .placing import place, relocalise
from .plan_update import update_by_plan
from .scan_update import KeyframeUpdate, track, update_map
from .slam_state import SlamState
from .stage_timer import StageTimer

# Metres of driving after which a robot that was not carried, and is not recognised where odometry has it, is in a new
# place. Origin: definition, the map of the known place does not extend farther.
MAX_SEARCH_DISTANCE = INDOOR_RANGE


@immutable
class ScanResult:
    """Effects of one scan.

    tracking    pose of the scan
    update      changes of the map; None if the scan did not become a keyframe
    retracted   closure that was undone because this scan contradicts it, if any
    mapper      map with the scan, before a closure was undone
    in_plan     true if the map was recognised in the plan and moved to its frame
    began_part  true if the pose was lost and a new part of the map began
    joined      first keyframe of the last part of the map if it was recognised in another one, or in the frozen map
    resumed     true if the part of the map that had begun last was discarded, as the robot has not left the earlier one
    """

    tracking: TrackingResult
    update: KeyframeUpdate | None
    retracted: LoopDecision | None
    mapper: Mapper
    in_plan: bool = False
    began_part: bool = False
    joined: int | None = None
    resumed: bool = False


class Estimator:
    """State of the estimate, and the monitor of its recent loop closures."""

    def __init__(self, state: SlamState) -> None:
        self.state = state
        self._monitor = ClosureMonitor()
        self._frozen_state: SlamState | None = None  # state of a frozen map while the robot is lost in it
        self._earlier: EarlierPart | None = None  # part before the present one, while the robot may be in it

    @property
    def result(self) -> SlamState:
        """State with the results: that of the frozen map if the robot is lost in it, else the present state."""
        return self.state if self._frozen_state is None else self._frozen_state

    @property
    def placed_by_odometry(self) -> bool:
        """True if the robot has driven on without being recognised where odometry has it: the place is new."""
        parts, travelled = self.state.mapper.landmarks.parts, self.state.mapper.travelled
        if self._frozen_state is not None or not parts.reachable(np.zeros(1, dtype=np.int64))[0]:
            return False
        return travelled[-1] - travelled[parts.current_first] > MAX_SEARCH_DISTANCE

    @property
    def in_largest_part(self) -> bool:
        """True if the robot maps in a part of the map that, with those joined with it, is larger than any other."""
        mapper = self.state.mapper
        return self._frozen_state is None and mapper.landmarks.parts.current_is_largest(mapper.keyframe_count)

    def process(self, scan: ProcessedScan, timer: StageTimer | None = None) -> ScanResult:
        """Update the state by one scan. `timer` measures the stages."""
        resumed = self._test_earlier_part(scan)
        if resumed is not None:
            return resumed
        was_on_trial = self._frozen_state is not None
        result = self._map_scan(scan, timer or StageTimer())
        if was_on_trial or self._frozen_state is not None:  # the map on trial is not a result
            return replace(result, update=None, mapper=self.result.mapper)
        return result

    def _map_scan(self, scan: ProcessedScan, timer: StageTimer) -> ScanResult:
        """Track a scan and update the map; if the pose is lost, begin a part of the map."""
        tracking = track(self.state, scan, timer)
        self._monitor.record(scan)  # before a closure, whose checkpoint includes this scan
        if tracking.fits_by_chance:
            return self._begin_part_with([scan], timer, kidnapped=True)
        update = self._update_map(scan, tracking, timer)
        in_plan = update is not None and self._frozen_state is None and update_by_plan(self.state, update.observations)
        mapper = self.state.mapper
        retracted = self._retract_contradicted_closure()
        if self.state.lost:
            unmeasured = self.state.may_have_been_carried or not self.state.tracker.measured
            began = self._begin_part_with(self.state.untracked_scans, timer, kidnapped=unmeasured)
            return replace(began, retracted=retracted)
        return ScanResult(tracking, update, retracted, mapper, in_plan=in_plan, joined=_joined_part(update))

    def _update_map(self, scan: ProcessedScan, tracking: TrackingResult, timer: StageTimer) -> KeyframeUpdate | None:
        """Update the map by a tracked scan, and close the loop that it confirms, if any."""
        update = update_map(self.state, scan, tracking, timer)
        if update is not None and update.loop is not None and update.loop.status is LoopStatus.CONFIRMED:
            update = self._close_loop(scan, update, update.loop)
            timer.lap("closing")
        return update

    def place(self, pose: se2.Pose, scan: ProcessedScan) -> bool:
        """Set the base's pose in the map, roughly known, at a scan; return False if the scan does not fit near it.

        A map on trial is discarded. False also if the robot maps a new part of the map, which has no known place.
        """
        trial = self.result.copy()
        parts = trial.mapper.landmarks.parts
        if trial.at_part_begin:
            parts.drop_last()
        if not trial.mapper.keyframe_count or parts.current_is_apart or not place(trial, pose, scan):
            return False
        self.state, self._frozen_state, self._earlier, self._monitor = trial, None, None, ClosureMonitor()
        return True

    def begin_part(self, pose: se2.Pose, odometry: Odometry, *, kidnapped: bool, expected: Expectation = LOST) -> None:
        """Map in a new part from now on, beginning at a pose; see `SlamState.begin_part`."""
        if self.state.frozen:
            self._frozen_state = self.state
            self.state = self.state.copy()
            self.state.frozen = False
        self.state.begin_part(pose, odometry, kidnapped=kidnapped, expected=expected)
        self._monitor, self._earlier = ClosureMonitor(), None

    def doubt_place(self, odometry: Odometry) -> None:
        """Map in a new part from now on, until the next scans show that the robot is where it was before.

        odometry  reading of odometry now, in its frame until now: it knows of no motion since the last scan
        """
        earlier = EarlierPart(self.state.copy(), self._monitor)
        self.begin_part(self.state.pose, odometry, kidnapped=True)
        self._earlier = earlier

    def freeze(self) -> None:
        """Keep the map as it is from now on; its closures are not monitored any more. The robot is not lost."""
        self.state.mapper.solve_waiting()
        self.state.frozen = True
        self._monitor, self._earlier = ClosureMonitor(), None

    def unfreeze(self, odometry: Odometry) -> None:
        """Extend the map again, from where the robot is; `odometry` is the reading of odometry at the last scan.

        If the robot is lost in the map, a new part of it begins; the map on trial is discarded.
        """
        lost = self._frozen_state is not None
        self.state, self._frozen_state, self._earlier = self.result, None, None
        self.state.frozen, self.state.untracked_scans, self.state.tentative = False, [], []
        self.state.last_tracked = None
        self.state.mapper.gauge.hold(self.state.mapper)
        if lost:
            self.begin_part(self.state.predict(odometry), odometry, kidnapped=True)

    def _begin_part_with(self, scans: Sequence[ProcessedScan], timer: StageTimer, *, kidnapped: bool) -> ScanResult:
        """Begin a part of the map with scans that did not fit; the result is that of the last one."""
        odometry = scans[0].reading
        earlier = self._earlier or EarlierPart(self.state.copy(), self._monitor)
        self.begin_part(self.state.predict(odometry), odometry, kidnapped=kidnapped)
        self._earlier = earlier
        for scan in scans:
            tracking = track(self.state, scan, timer)
            update = update_map(self.state, scan, tracking, timer)
        return ScanResult(tracking, update, None, self.state.mapper, began_part=True)

    def _test_earlier_part(self, scan: ProcessedScan) -> ScanResult | None:
        """Add a scan to the test of the earlier part; return to that part if it shows that the robot has not left it.

        The result is None if the robot stays in the present part, or if there is no earlier one to test.
        """
        if self._earlier is None:
            return None
        tracking = self._earlier.add(scan)
        if self._earlier.expired:
            self._earlier = None
        if tracking is None or self._earlier is None or not self._earlier.confirmed:
            return None
        self.state, self._monitor = self._earlier.state, self._earlier.monitor
        self._earlier = self._frozen_state = None
        return ScanResult(tracking, None, None, self.state.mapper, resumed=True)

    def _close_loop(self, scan: ProcessedScan, update: KeyframeUpdate, decision: LoopDecision) -> KeyframeUpdate:
        """Close a confirmed loop on a copy of the state; keep the copy if the map fits together.

        If the loop joins the map on trial with the frozen one, the robot is relocalised in that. If it leads to where
        odometry has the robot in the earlier part, it is not closed: the next scan returns to that part.
        """
        joined = se2.compose(decision.correction, self.state.pose)
        if decision.joins and self._earlier is not None and self._earlier.recognise(joined, scan.reading):
            return replace(update, loop=None)
        trial, superseded = self.state.copy(), self.state.mapper
        decision = close_loop(trial, update.observations, decision)
        if decision.status is not LoopStatus.ACCEPTED:
            return replace(update, loop=decision)
        if decision.joins:
            self._earlier = None
        if self._frozen_state is not None and decision.old < self._frozen_state.mapper.keyframe_count:
            self.state, self._frozen_state = self._frozen_state.copy(), None
            relocalise(self.state, trial, scan.reading)
            return replace(update, loop=replace(decision, since=self.state.mapper.keyframe_count))
        self._monitor.add(self.state, decision)
        self.state = trial
        return replace(update, loop=decision, superseded=superseded)

    def close_last_loop(self) -> tuple[LoopDecision, Mapper] | None:
        """Close the loop at the end of a run that no further look can confirm, if the evidence for it suffices.

        Returns the decision and the map before it. None if there is no such loop, or if the map is not extended: the
        state is unchanged then, so that a run which continues the session is as one that has not been interrupted.
        """
        if not self._closes_last_loops:
            return None
        before = self.state.copy()
        before.mapper.solve_waiting()
        decision = search_last_loop(before)
        if decision is None:
            return None
        closed = before.copy()
        decision = close_loop(closed, None, decision)
        if decision.status is not LoopStatus.ACCEPTED:
            return None
        self._monitor.add(before, decision)
        self.state = closed
        return decision, before.mapper

    @property
    def _closes_last_loops(self) -> bool:
        """True if loops may be closed at the end: if there is a map, and it is extended."""
        return self._frozen_state is None and not self.state.frozen and self.state.mapper.keyframe_count > 0

    def close_displaced_loops(self, journal: Journal) -> Iterator[tuple[LoopDecision, Mapper]]:
        """Close the loops that displaced scans show, at the end of a run; see `displaced_loops`.

        Yields each decision and the map before it. There is none if the map is not extended.
        """
        if not self._closes_last_loops or not self.state.config.loop_closure.enabled:
            return
        for closed, decision in close_displaced_loops(self.state, journal):
            before, self.state = self.state, closed
            yield decision, before.mapper

    def _retract_contradicted_closure(self) -> LoopDecision | None:
        """Undo a closure that later scans contradict: return to its checkpoint and process the scans since again."""
        closure = self._monitor.contradicted(self.state.mapper, lost=self.state.lost)
        if closure is None:
            return None
        self.state = closure.checkpoint
        excluding = self.state.joins if closure.decision.joins else self.state.loops
        excluding.exclude(closure.decision.correction)
        for scan in closure.scans:
            update_map(self.state, scan, track(self.state, scan, StageTimer()), StageTimer())
        return closure.decision


def _joined_part(update: KeyframeUpdate | None) -> int | None:
    """Return the first keyframe of the group of parts that the loop closed at a keyframe joined with another one.

    None if it joined nothing, or if that is the group of the first keyframe of the map.
    """
    decision = None if update is None else update.loop
    if decision is None or not decision.joins or decision.status is not LoopStatus.ACCEPTED:
        return None
    return decision.since or None
