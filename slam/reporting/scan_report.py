"""Report of what the scans of a run change: counted for its summary, and published."""

from __future__ import annotations

from ..estimation.estimator import ScanResult
from ..estimation.slam_state import SlamState
from ..estimation.stage_timer import StageTimer
from ..events import Notice
from ..loop_closure.decision import LoopDecision
from ..mapping.mapper import Mapper
from ..odometry.velocity import VelocityFilter
from ..preprocessing.preprocessor import ProcessedScan
from .publisher import Publisher
from .run_statistics import RunStatistics


class ScanReport:
    """Counts and publishes the effects of scans."""

    def __init__(self, publisher: Publisher, statistics: RunStatistics) -> None:
        self._publisher, self._statistics = publisher, statistics

    def add(
        self,
        scan: ProcessedScan,
        result: ScanResult,
        state: SlamState,
        sigma_range: float,
        timer: StageTimer,
        velocity: VelocityFilter | None,
    ) -> None:
        """Report the effects of a scan.

        result       effects of the scan
        state        with the results of the run, after the scan
        sigma_range  standard deviation of a range, metres
        timer        with the times of the scan's processing
        velocity     of the base at the scan while odometry is failing, else None
        """
        statistics, publisher, mapper = self._statistics, self._publisher, state.mapper
        statistics.add_tracking(scan, result.tracking)
        publisher.publish_tracking(scan, result.tracking, mapper, state.odometry_model, velocity)
        if result.update is not None:
            statistics.add_keyframe(result.update, timer)
            publisher.publish_keyframe(result.mapper, result.update, sigma_range, timer)
            self.add_rejected_loops(state, scan.stamp)
        if result.in_plan:
            publisher.publish(Notice(scan.stamp, "recognised in the plan", "INFO"))
            publisher.publish_map(scan.stamp, mapper)
        if result.retracted is not None:
            self.add_loop(result.retracted, scan.stamp, mapper, result.mapper)

    def add_loop(self, decision: LoopDecision, stamp: float, mapper: Mapper, superseded: Mapper) -> None:
        """Report a loop that was retracted, or closed after the last scan, at a stamp (seconds).

        superseded  map before
        """
        self._statistics.add_loop(stamp, decision)
        self._publisher.publish_loop(decision, stamp, mapper, superseded)

    def add_rejected_loops(self, state: SlamState, stamp: float, *, ended: bool = False) -> None:
        """Report the hypotheses of loops and joins that were given up; if the run has `ended`, also all others.

        stamp  of the scan at which this is reported, seconds
        """
        joins = [state.loops.number(decision) for decision in state.joins.take_rejected(ended=ended)]
        for decision in (*state.loops.take_rejected(ended=ended), *joins):
            self._statistics.add_loop(state.keyframe_stamps[decision.keyframe], decision)
            self._publisher.publish_rejected_loop(decision, stamp, state.mapper)

    def end(self, state: SlamState, stamp: float) -> None:
        """Report at the end of a run the loops that remain undecided, and where scans or odometry told nothing."""
        self.add_rejected_loops(state, stamp, ended=True)
        self._publisher.publish_stretches()
        self._publisher.publish_deviations(len(self._statistics.overlap_ratios))
