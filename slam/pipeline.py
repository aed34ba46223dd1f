"""The story of a scan: straightened, condensed into walls and corners, laid over the map, and made part of it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from drivers import se2
from drivers.messages import GroundTruth, Message, Scan

from .belief import Belief, Extension
from .config import Config
from .errors import MapError
from .estimator import Estimator, Step
from .events import Finished, MapCorners, MapLines, Noticed, ScanTracked, Sink, StateChanged, TruthSeen
from .front_end import FrontEnd, Sighting
from .loops.closer import LoopCloser
from .mapper import Mapper
from .recovery import Excursion, Suspicion
from .refinement import drive_of, laid_path, refine
from .reporting import Reporter
from .segments import Floats
from .snapshot import map_corners, map_lines
from .state import State, StateWatch
from .statistics import Clock, RunStatistics
from .tracking import Hold, Placement


class Slam:
    """2-D SLAM with walls and corners. Feed it messages in time order, read the pose whenever you like, then finish.

    slam = Slam()
    for message in drivers.open("intel.clf"):
        slam.add(message)
    result = slam.finish()
    """

    def __init__(
        self,
        config: Config | None = None,
        sinks: Sequence[Sink] = (),
        *,
        refine: bool = False,
        loops: LoopCloser | None = None,
    ) -> None:
        """`refine` asks for a second look at everything before finishing; for that, what was sighted in familiar places
        is kept, too.

        `loops` looks for loops in another way than the default.
        """
        self.config = config or Config()
        self._reporter = Reporter(sinks)
        self._front_end = FrontEnd(self.config)
        self._estimator = Estimator(Belief(self.config.odometry, loops))
        self._excursion: Excursion | None = None  # while the robot is lost
        self._suspicion: Suspicion | None = None  # while what it sees may belong elsewhere
        self._refine = refine
        self._journal: list[Sighting] = []  # everything sighted, for looking back at the end
        self._state = StateWatch()
        self._statistics = RunStatistics()

    # --- what goes in

    def add(self, message: Message) -> None:
        """Take the next message. A scan is worked on once the odometry covers its sweep."""
        if isinstance(message, GroundTruth):
            self._reporter.tell(TruthSeen(message.stamp, message.pose))
            return
        self._front_end.add(message)
        while (scan := self._front_end.next_scan()) is not None:
            self._add_scan(scan)

    # --- the story of a scan

    def _add_scan(self, scan: Scan) -> None:
        clock = Clock()
        sighting = self._front_end.sight(scan, self.belief.odometry_noise)
        clock.lap("features")
        self._journal.append(sighting)
        if self._excursion is not None:
            self._look_for_the_way_back(self._excursion, sighting)
            return
        step = self._estimator.take(sighting, clock)
        if self.belief.in_familiar_place and not self._refine:
            self._journal[-1] = sighting.without_view()
        self._note(sighting, step.placement)
        if step.extension is not None:
            self._tell_keyframe(sighting, step.mapper, step.extension, clock)
        if step.retracted is not None:
            self._statistics.add_loop(sighting.stamp, step.retracted)
            self._reporter.tell_loop(step.retracted, sighting.stamp, self.belief.mapper, step.mapper)
        self._suspect(sighting, step)
        if self.belief.lost:
            self._excursion = Excursion(self.config.odometry, self.belief, self.belief.unplaced)
            self._suspicion = None
            self._tell_state(sighting.stamp, self._state.lose())

    def _suspect(self, sighting: Sighting, step: Step) -> None:
        """The view may have changed at a stroke: see for a while whether the robot is not somewhere else on the map."""
        if step.before is not None and self._suspicion is None:
            self._suspicion = Suspicion(self.config.odometry, step.before)
        if self._suspicion is None:
            return
        self._suspicion.add(sighting, step.placement)
        found = self._suspicion.borne_out()
        if found is not None:
            self._go_on_from(found, sighting.stamp, "carried away: found elsewhere in the map")
        elif self._suspicion.over:
            self._suspicion = None

    def _look_for_the_way_back(self, excursion: Excursion, sighting: Sighting) -> None:
        """The robot is lost: see whether what it has seen since is somewhere on the map."""
        excursion.add(sighting)
        self._statistics.lost += 1
        found = excursion.recognised()
        if found is not None:
            self._go_on_from(found, sighting.stamp, "found again in the map")

    def _go_on_from(self, estimator: Estimator, stamp: float, text: str) -> None:
        self._estimator, self._excursion, self._suspicion = estimator, None, None
        self._reporter.tell(Noticed(stamp, text))
        self._reporter.tell_map(stamp, self.belief.mapper)
        self._tell_state(stamp, self._state.find())

    def _tell_state(self, stamp: float, state: State | None) -> None:
        if state is None:
            return
        self._statistics.states.append((stamp, state))
        self._reporter.tell(StateChanged(stamp, state.condition.value, state.direction))

    def _note(self, sighting: Sighting, placement: Placement) -> None:
        """Count how the scan was placed, and tell the listeners."""
        stamp, explained = sighting.stamp, placement.registration.explained
        self._statistics.explained.append(explained)
        if placement.hold is Hold.SEARCHED:
            self._statistics.searched += 1
            self._reporter.tell(Noticed(stamp, "odometry is far off; the pose was searched for and found in the map"))
        elif placement.hold is Hold.NONE:
            self._statistics.unplaced += 1
            self._reporter.tell(Noticed(stamp, "the scan fits nowhere near; left out"))
        elif placement.hold is Hold.BLIND:
            self._statistics.blind += 1
        self._tell_state(stamp, self._state.update(placement))
        keyframe = self.belief.mapper.keyframe_count - 1
        self._reporter.tell(ScanTracked(stamp, placement.pose, sighting.odometry, explained, keyframe))

    def _tell_keyframe(self, sighting: Sighting, mapper: Mapper, extension: Extension, clock: Clock) -> None:
        """Count what the keyframe did to the map, and tell the listeners."""
        self._statistics.add_keyframe(clock)
        self._statistics.merged_walls += extension.merge is not None
        if extension.loop is not None:
            self._statistics.add_loop(sighting.stamp, extension.loop)
        self._reporter.tell_keyframe(sighting, mapper, extension, self._front_end.sigma_range, dict(clock.laps))

    # --- what comes out

    @property
    def belief(self) -> Belief:
        """What is believed now, to look into: where the robot is, its path, the map under construction."""
        return self._estimator.belief

    @property
    def pose(self) -> se2.Pose:
        """The base's pose [x, y, heading] in the map at the last scan; see `state` for how well it is known."""
        return (self.belief if self._excursion is None else self._excursion).pose.copy()

    @property
    def state(self) -> State:
        """Whether the robot knows where it is."""
        return self._state.state

    @property
    def walls(self) -> MapLines:
        """The walls as they are known now, without covariances: those cost time, `finish` gives them."""
        return map_lines(self.belief.mapper, covariances=False)

    @property
    def corners(self) -> MapCorners:
        """The corners as they are known now, without covariances."""
        return map_corners(self.belief.mapper, covariances=False)

    def finish(self) -> Finished:
        """Work off what waits, settle the estimate, and return path and map with the covariances of their marginals.

        Raises MapError where there was nothing to make a map of.
        """
        if not self._front_end.scans:
            raise MapError("no laser scan in it, so there is nothing to map")
        if not len(self._front_end.odometry):
            raise MapError(f"{self._front_end.scans} scans, but no odometry; SLAM needs both")
        while (scan := self._front_end.next_scan(last=True)) is not None:
            self._add_scan(scan)
        if self._excursion is not None:
            last = self._excursion.sightings[-1].stamp
            self._go_on_from(self._excursion.joined(), last, "never found again in the map; odometry has to do")
        self.belief.mapper.settle()
        summary = self._summary() | self._look_back()
        keyframes = self.belief.mapper.trail
        stamps, poses = self.belief.path.at_odometry(keyframes, self._front_end.odometry)
        result = Finished(
            lines=map_lines(self.belief.mapper, covariances=True),
            corners=map_corners(self.belief.mapper, covariances=True),
            keyframe_stamps=np.array(self.belief.keyframe_stamps),
            keyframes=keyframes,
            stamps=stamps,
            poses=poses,
            summary=summary,
            keyframe_covariance=np.array([self.keyframe_covariance(index) for index in range(len(keyframes))]),
        )
        self._reporter.tell_residuals(float(stamps[-1]), self.belief.mapper)
        self._reporter.tell(result)
        return result

    def _look_back(self) -> dict[str, object]:
        """Lay everything sighted over the finished map, after refining that if it is wanted; what the summary gets."""
        belief, last = self.belief, self._journal[-1].stamp
        if belief.mapper.keyframe_count < 2:
            return {}
        drive = drive_of(self._journal, belief.path, belief.keyframe_stamps, belief.carried_keyframes)
        try:
            if not self._refine:
                belief.path = laid_path(belief.mapper, drive, belief.odometry_noise)
                return {}
            refined = refine(belief.mapper, drive, belief.odometry_noise)
        except MapError as error:
            self._reporter.tell(Noticed(last, f"what was seen is not looked back at: {error}"))
            return {}
        belief.mapper, belief.path, belief.pose = refined.mapper, refined.path, refined.poses[-1]
        self._reporter.tell_map(last, belief.mapper)
        return {"refinement": refined.summary}

    def keyframe_covariance(self, index: int) -> Floats:
        """(3, 3): covariance of a keyframe's pose, in the keyframe's own frame (metres, metres, radians)."""
        return self.belief.mapper.graph.keyframe_covariance(index)

    def _summary(self) -> dict[str, object]:
        return {
            "scans": self._front_end.scans,
            "keyframes": self.belief.mapper.keyframe_count,
            "factors": self.belief.mapper.graph.factor_count,
            "merged_walls": self._statistics.merged_walls,
            "loops": self._statistics.loop_counts(),
            "loop_decisions": self._statistics.loops,
            "states": self._statistics.state_rows(),
            "odometry_deviation_per_metre": self.belief.odometry_noise.deviations.round(5).tolist(),
            "sigma_range": round(self._front_end.sigma_range, 5),
            "wall_unevenness": round(math.sqrt(self.belief.mapper.flatness.variance), 5),
            "timings": self._statistics.timings(),
            "health": self._statistics.health()
            | {
                "empty_scans": self._front_end.empty_scans,
                "scans_without_odometry": self._front_end.scans_without_odometry,
            },
        }
