"""SLAM from messages to map: `Slam.add` takes the messages, `Slam.finish` returns map and trajectory."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from numbers import Integral
from typing import TYPE_CHECKING

from drivers import se2
from drivers.arguments import check_type
from drivers.messages import GroundTruth, InitialPose, Message, Odometry, delay_odometry, on_clock_of_first

from .config import Config
from .errors import MapError, SlamError
from .estimation.estimator import Estimator
from .estimation.map_view import map_features
from .estimation.scan_update import add_second_look
from .estimation.slam_state import SlamState
from .estimation.stage_timer import StageTimer
from .events import Finished, GroundTruthReceived, ModeChanged, Notice, Sink
from .formatting import counted
from .geometry.segments import Floats
from .localisation.state import LocalisationEvent, LocalisationState
from .localisation.tracking import TrackingResult
from .loop_closure.agreement import LoopAgreement
from .mapping.convergence import converge
from .mapping.manual_changes import fragile_changes
from .mapping.map_features import MapCorners, MapWalls
from .mapping.plan_map import VIEWS_END, PlanMap
from .odometry.history import OdometryHistory
from .odometry.motion_source import MotionSource
from .preprocessing.extraction import warn_of_compilation
from .preprocessing.message_check import MessageCheck
from .preprocessing.preprocessor import ProcessedScan
from .preprocessing.scan_queue import ScanPair
from .recognition.location import STATED
from .reporting.delay_warning import DelayWarning
from .reporting.localisation_report import LocalisationReport
from .reporting.publisher import Publisher
from .reporting.run_statistics import RunStatistics, run_summary
from .reporting.scan_report import ScanReport
from .run_end import is_unknown_place, map_alone, publish_run, settle_plan, settle_trajectory
from .run_session import RunSession, RunSnapshot
from .run_start import check_arguments, continued_state, initial_pose, new_state, start_journal, start_preprocessor

if TYPE_CHECKING:
    from .io.sessions import StoredSession


class Slam:
    """2-D SLAM with walls and corners: add messages in time order, read the pose at any time, then finish.

    pipeline = Slam()
    for message in drivers.open("intel.clf"):
        pipeline.add(message)
    result = pipeline.finish()
    """

    def __init__(
        self,
        config: Config | None = None,
        sinks: Sequence[Sink] = (),
        *,
        refine: bool = False,
        keep_all_features: bool = False,
        loops: LoopAgreement | None = None,
        resumed: StoredSession | None = None,
        frozen: bool = False,
        start: Sequence[float] | Floats | None = None,
        plan: PlanMap | None = None,
    ) -> None:
        """Create an empty map, or continue a session.

        config             settings; by default those of the session, if there is one
        refine             refine the whole map offline in `finish`
        keep_all_features  keep the features of scans in familiar places too, and of a robot that stands, so that the
                           session can be refined later; memory then grows with time. Implied by `refine`
        loops              search for loop closures in another way than the default
        resumed            session to continue, with later stamps: directly if odometry is continuous, else after
                           relocalisation in its map
        frozen             keep the map of the session unchanged and only estimate the trajectory in it, see `unfreeze`
        start              roughly known pose [x, y, heading] of the base in the map of the session, or in the plan, at
                           the first scan; without it the robot may be anywhere
        plan               plan of the building: once the map is recognised in it, it is in the plan's frame, and walls
                           that agree with the plan are supported by it. Not with `resumed`
        """
        check_arguments(config, sinks, resumed, plan)
        if plan is not None and resumed is not None:
            raise MapError("a plan cannot be used together with a session that is continued")
        if resumed is None and (frozen or (start is not None and plan is None)):
            raise MapError("there is no map for `frozen` or `start`: they require a session, or `start` a plan")
        if refine and resumed is not None and (changes := fragile_changes(resumed.slam_state.mapper)):
            raise MapError(f"the session to continue has {changes}, which a refinement would drop")
        placed = None if start is None else initial_pose(start)
        self._initial_pose = placed if plan is None else None
        self.config = config or (Config() if resumed is None else resumed.config_to_continue)
        self._refine, self._extends_map = refine, not frozen
        self._publisher = Publisher(sinks)
        self._statistics = RunStatistics()
        self._report = ScanReport(self._publisher, self._statistics)
        self._delay_warning = DelayWarning(self._publisher)
        self._check, self._has_odometry = MessageCheck(-math.inf if resumed is None else resumed.latest), False
        self._session: StoredSession | None = None
        self._preprocessor = start_preprocessor(self.config, resumed)
        if resumed is None:
            self._estimator = Estimator(new_state(self.config, loops, plan, placed))
        else:
            self._estimator = Estimator(continued_state(self.config, resumed))
        self._journal = start_journal(resumed, keep_all_features=refine or keep_all_features)
        self._motions = MotionSource(self.config.odometry, self._journal.segments.last_reading)
        self._run_session = RunSession(self.config, self._journal, self._preprocessor, self._statistics, resumed)
        self._localisation = LocalisationReport(
            self.slam_state.odometry_model.unobserved_sigma, self._publisher, self._statistics
        )
        if frozen:
            self.slam_state.freeze()
            self._journal.begin_localising()

    # --- input

    def add(self, message: Message) -> None:
        """Add the next Scan, Odometry, YawRate or InitialPose; GroundTruth is only passed on to the sinks.

        A scan is processed once odometry covers its sweep. Scans must come in the order of their stamps, and odometry
        too; a scan may come after later odometry. Arrays may also be lists, or of other types of numbers. Raises
        MessageError if the message cannot be used, which leaves the run as it is, and SlamError after `finish`.
        """
        if self._session is not None:
            raise SlamError("the run has ended, finish() was called: continue its session in another one")
        message = delay_odometry(self._check.checked(message), self.config.lidar.delay or 0.0)
        message = on_clock_of_first(message, self.config.second_lidar_delay)
        if isinstance(message, GroundTruth):
            self._publisher.publish(GroundTruthReceived(message.stamp, message.pose))
            return
        if isinstance(message, InitialPose):
            self._initial_pose = message.pose
            return
        for measurement in self._motions.measurements(message):
            if isinstance(measurement, Odometry) and not self._has_odometry:
                self._start(measurement)
            if isinstance(measurement, Odometry) and self._motions.jump is not None:
                self._publisher.publish(Notice(measurement.stamp, self._motions.jump))
            self._preprocessor.add(measurement)
            while (scan := self._preprocessor.next_scan()) is not None:
                self._process_scan(scan)

    def _process_scan(self, scan: ScanPair) -> None:
        """De-skew a scan, extract features, track the pose, update the map, and publish the results."""
        timer = StageTimer()
        tracker = self._estimator.state.tracker
        if not self._preprocessor.is_measured(scan):
            tracker.stop_odometry()
        processed = self._preprocessor.process(scan, self.slam_state.odometry_model, tracker.predicted_velocity)
        timer.lap("features")
        self._journal.add(processed)
        before = self._estimator.state.matched_pose if self._motions.learns else None
        if self._initial_pose is not None:
            self._place(processed, self._initial_pose)
            before = None
        result = self._estimator.process(processed, timer)
        self._learn_motion(processed.stamp, result.tracking, before)
        if self._motions.predicted:
            result = replace(result, tracking=replace(result.tracking, slipped=False))  # there is nothing that can slip
        if not self.frozen and self.slam_state.in_familiar_place:
            self._journal.note_familiar_place()
        self._journal.mark_dispensable(self._estimator.state.keyframe_stamps)
        self._statistics.lost_scans += self._localisation.lost
        velocity = self._estimator.state.tracker.predicted_velocity
        self._report.add(processed, result, self.slam_state, self._preprocessor.noise.sigma_range, timer, velocity)
        self._localisation.update(processed.stamp, result, self._estimator)
        self._delay_warning.update(self.slam_state, self._journal, processed.stamp)

    def _learn_motion(self, stamp: float, tracking: TrackingResult, before: se2.Pose | None) -> None:
        """Correct the source of the motions by that between the last two scans, if it learns.

        stamp   of the last scan, seconds
        before  pose of the base in the map at the scan before; None if it is not known
        """
        if not self._motions.learns:
            return
        matched = self._estimator.state.matched_pose
        turned = 0.0 if matched is None else float(se2.between(tracking.pose, matched)[2])
        self._motions.correct(stamp, tracking.motion_since(before), tracking.covariance, turned)

    # --- start

    def _start(self, first: Odometry) -> None:
        """Start at the first odometry: it continues that of the session, or the robot may be anywhere in its map."""
        warn_of_compilation()
        self._has_odometry = True
        if self.frozen:
            self._publisher.publish(ModeChanged(first.stamp, frozen=True))
        earlier = self._run_session.earlier
        if earlier is None:
            self._use_odometry(self._journal.start_odometry_segment())
            return
        self._publisher.publish_map(first.stamp, self.slam_state.mapper)
        self._use_odometry(self._journal.segments.histories[-1])
        continued = not self._motions.predicted and self._journal.segments.is_continued_by(first)
        if continued and self._motions.jump is None:
            return
        self._process_queue(sum(not scan.lidar for scan in earlier.queued_scans))
        self._journal.begin_run()
        if continued:  # the wheels were not read for a while, and the robot may have driven
            self._estimator.doubt_place(first)
        else:
            self._use_odometry(self._journal.start_odometry_segment())
            self.slam_state.odometry_model.begin_drive()
            self._estimator.begin_part(self.slam_state.pose, first, kidnapped=True, expected=STATED)
        self._localisation.handle(first.stamp, LocalisationEvent.STARTED_ANYWHERE)

    def _use_odometry(self, history: OdometryHistory) -> None:
        """Append the readings to a history from now on, and predict motions by it."""
        self._preprocessor.odometry = self.slam_state.dead_reckoning.history = history

    def _place(self, scan: ProcessedScan, pose: se2.Pose) -> None:
        """Move the robot to the pose that was set, if the scan fits near it."""
        self._initial_pose = None
        if not self._estimator.place(pose, scan):
            text = "the initial pose is not used: the scan does not fit near it"
            self._publisher.publish(Notice(scan.stamp, text))
            return
        self._publisher.publish(Notice(scan.stamp, "the robot is placed at the initial pose", "INFO"))
        if self._localisation.lost:
            self._localisation.handle(scan.stamp, LocalisationEvent.RELOCALISED)

    # --- mode

    @property
    def frozen(self) -> bool:
        """True while the map is kept as it is, and only the pose in it is estimated."""
        return self.slam_state.frozen

    @property
    def extends_map(self) -> bool:
        """True if this run extends the map, or did before; false if it has only localised in that of a session."""
        return self._extends_map

    def freeze(self) -> None:
        """Keep the map as it is from now on, and only estimate the pose in it; no effect if that is so already.

        Raises MapError if there is no map yet, or if the robot is LOST.
        """
        if self.frozen:
            return
        if not self.slam_state.mapper.keyframe_count:
            raise MapError("nothing is mapped yet")
        if self._localisation.lost:
            raise MapError("the robot is LOST, so there is no map around it to localise in")
        self._estimator.freeze()
        self._journal.begin_localising()
        self._publish_mode()

    def unfreeze(self) -> None:
        """Extend the map again from where the robot is; no effect if that is so already.

        If the robot is LOST, it maps in a new part of the map, until that is recognised. The walls of a plan are
        landmarks from then on, with the covariances that they have in it.
        """
        if not self.frozen:
            return
        if self._journal.scans:
            self._estimator.unfreeze(self._journal.scans[-1].reading)
        else:
            self.slam_state.frozen = False
        self._journal.end_localising()
        self._extends_map = True
        self._publish_mode()

    def _publish_mode(self) -> None:
        stamp = self._journal.scans[-1].stamp if self._journal.scans else 0.0
        self._publisher.publish(ModeChanged(stamp, self.frozen))

    # --- output

    @property
    def slam_state(self) -> SlamState:
        """Current state of the estimate: pose, trajectory and the map under construction."""
        return self._estimator.result

    @property
    def pose(self) -> se2.Pose:
        """Pose of the base [x, y, heading] in the map at the last scan; see `state` for how well it is known."""
        return self._estimator.state.pose.copy()

    @property
    def state(self) -> LocalisationState:
        """Localisation status: OK, DEGENERATE in one direction, or LOST."""
        return self._localisation.state

    @property
    def walls(self) -> MapWalls:
        """Current walls, without covariances, which cost time: `finish` returns them."""
        return map_features(self.slam_state.mapper)[0]

    @property
    def corners(self) -> MapCorners:
        """Current corners, without covariances."""
        return map_features(self.slam_state.mapper)[1]

    @property
    def lidar_mounts(self) -> list[se2.Pose]:
        """Pose [x, y, heading] on the base of each lidar whose scans were used: as set, else as the scans state."""
        return self._preprocessor.mounts

    @property
    def session(self) -> StoredSession:
        """Complete estimate, to be stored and continued. Raises SlamError before `finish`."""
        if self._session is None:
            raise SlamError("the session is available after finish() only")
        return self._session

    def snapshot(self) -> RunSnapshot:
        """Return a copy of the run, to be saved while it goes on. Raises MapError before the first keyframe."""
        if not self.slam_state.mapper.keyframe_count:
            raise MapError("nothing is mapped yet")
        summary = self._summary(self._journal.scans[-1].stamp)
        return self._run_session.snapshot(self.slam_state, summary, self._results_after)

    def keyframe_covariance(self, index: int) -> Floats:
        """Return the covariance (3, 3) of a keyframe's pose in its own frame (metres, metres, radians).

        Raises MapError if there is no such keyframe.
        """
        check_type("index", index, Integral, "a whole number")
        count = self.slam_state.mapper.keyframe_count
        if not 0 <= index < count:
            raise MapError(f"there is no keyframe {index}: the map has {counted(count, 'keyframe')}")
        features = self._journal.features_at(self.slam_state.keyframe_stamps[index])
        return self.slam_state.mapper.covariances.of_keyframe(index) + features.sweep_covariance

    # --- end of the run

    def finish(self) -> Finished:
        """Process the queued scans, settle the map, and return map and trajectory with marginal covariances.

        Raises MapError if there was nothing to map.
        """
        self._check.finish()
        if not self._preprocessor.scans:
            raise MapError("no laser scan, so there is nothing to map")
        if not self._has_odometry:
            remedy = "add --no-odometry to map without, in Python Config().without_odometry()"
            raise MapError(f"{self._preprocessor.scans} scans, but no odometry; {remedy}")
        self._close_last_loops()
        session = self._session_with_queue()
        self._process_queue()
        add_second_look(self.slam_state)
        self._leave_out_unknown_session()
        self._journal.mark_rest_dispensable(self.slam_state.keyframe_stamps)
        state = self.slam_state
        self._session = session or self._run_session.at_end(state.copy())
        summary = self._settle(self._session)
        if self._refine:
            self._session = self._run_session.at_end(state)
        return publish_run(state, self._journal, self._publisher, summary, after=self._results_after)

    def _close_last_loops(self) -> None:
        """Close the loops at the end of the drive, if there are any: no further scan will confirm them."""
        last = self._estimator.close_last_loop()
        displaced = self._estimator.close_displaced_loops(self._journal)
        for decision, superseded in chain(() if last is None else (last,), displaced):
            stamp = self.slam_state.keyframe_stamps[decision.keyframe]
            self._report.add_loop(decision, stamp, self.slam_state.mapper, superseded)

    def _settle(self, session: StoredSession) -> dict[str, object]:
        """Settle the map and the trajectory; return the summary. `session` gets the decisions that this leads to."""
        state, journal = self.slam_state, self._journal
        state.local_field.clear()  # frees some megabytes: no scan is matched with it any more
        state.loops.free_submaps()
        if self._extends_map:
            if state.plan is not None:
                state.plan.correct_drift(state.mapper, state.local_field)
            self._statistics.merged_walls += converge(state.mapper)
            settle_plan(state, journal, self._publisher)
        end = journal.scans[-1].stamp
        self._report.end(state, end)
        self._delay_warning.update(state, journal, end, ended=True)
        self._run_session.add_last_decisions(session, state.loops)
        refined = self._refine and self._extends_map
        return self._summary(end) | settle_trajectory(state, journal, self._publisher, refined=refined)

    @property
    def _results_after(self) -> float:
        """Stamp (seconds) after which poses belong to the results.

        If the run only localises, these are its own poses; else all poses but the views of a plan, where nothing was
        driven.
        """
        return VIEWS_END if self._extends_map else self._journal.resumed_at

    def _summary(self, end: float) -> dict[str, object]:
        """Return the summary of the run up to the stamp `end` as plain data."""
        summary = run_summary(self._preprocessor, self.slam_state, self._statistics, end) | self._motions.summary()
        return {"extends_map": self._extends_map} | summary

    def _process_queue(self, count: int = sys.maxsize) -> None:
        """Process at most `count` queued scans without odometry to cover them."""
        while count > 0 and (scan := self._preprocessor.next_scan(flush=True)) is not None:
            self._process_scan(scan)
            count -= 1

    def _session_with_queue(self) -> StoredSession | None:
        """Return the session with the queued scans still in the queue, as if the run had not ended.

        None if no scan is queued, or if the robot was never recognised in an earlier session, which the end decides on.
        """
        if self._is_unknown_place or not self._preprocessor.queued or not self.slam_state.mapper.keyframe_count:
            return None
        return self._run_session.with_queue(self.slam_state.copy())

    @property
    def _is_unknown_place(self) -> bool:
        """True if nothing of this run is in a place that is known to be in the map of the earlier session."""
        if self._run_session.earlier is None:
            return False
        anywhere = self._statistics.started_anywhere
        return is_unknown_place(self._estimator, self._journal, frozen=not self._extends_map, anywhere=anywhere)

    def _leave_out_unknown_session(self) -> None:
        """Map this run alone if it was never recognised in the map of the earlier session.

        Raises MapError if that map is not extended.
        """
        if not self._is_unknown_place:
            return
        if not self._extends_map:
            raise MapError(
                "the robot was never relocalised in the map of the session; state roughly where it starts (start)"
            )
        self._run_session.earlier = None
        self._estimator = map_alone(self.config, self._journal, self._statistics, self._publisher)
