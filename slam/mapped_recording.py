"""Map a recording with one call; the result displays itself in a notebook, and measures and draws itself."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers import se2
from drivers.immutable import immutable
from drivers.messages import GroundTruth, Odometry, Source

from .config import Config
from .errors import MapError, OutputError
from .evaluation.metrics import score_true_path
from .events import Finished, Sink
from .formatting import counted
from .geometry.segments import Floats
from .io.exports.svg import svg_text
from .io.keyframes_csv import Keyframes
from .io.recording_facts import RecordingFacts
from .io.recording_timing import timed
from .io.recordings import open_to_map, recording_to_reopen
from .io.run_results import RunResults
from .io.tum import Trajectory
from .io.wall_maps import settled_wall_map
from .mapping.map_features import MapCorners, MapWalls
from .measuring.map_measurements import measure_map
from .measuring.measured_map import MeasuredMap
from .measuring.measurement import Measurement
from .measuring.rooms import Room, find_rooms
from .measuring.wall_map import WallMap
from .pipeline import Slam
from .run_saving import save_run

if TYPE_CHECKING:
    from .io.exports import Occupancy


@immutable
class MappedRecording:
    """Map and path of a recording.

    name      of the recording
    finished  everything that was estimated, with covariances
    odometry  (m, 3) path by odometry alone, in the map; (0, 3) without odometry
    truth     true path in the map, aligned with the estimated one; None if the recording has none
    slam      pipeline that made it
    source    recording as it was read
    reopen    argument of `drivers.open` that opens the recording again, from any working directory
    config    settings, without what the recording shows of the lidars
    facts     on the recording, as in `summary.json`: gaps, timing, interpretations, doubts
    """

    name: str
    finished: Finished
    odometry: Floats
    truth: Trajectory | None
    slam: Slam
    source: Source
    reopen: str
    config: Config
    facts: dict[str, Any]

    @property
    def walls(self) -> MapWalls:
        """Walls with covariances."""
        return self.finished.walls

    @property
    def corners(self) -> MapCorners:
        """Corners with covariances."""
        return self.finished.corners

    @property
    def stamps(self) -> Floats:
        """Stamps (n,) of the path, seconds."""
        return self.finished.stamps

    @property
    def path(self) -> Floats:
        """Poses (n, 3) of the base in the map: [x, y, heading], metres and radians."""
        return self.finished.poses

    @property
    def trajectory(self) -> Trajectory:
        """Path with its stamps."""
        return Trajectory(self.stamps, self.path)

    @property
    def keyframes(self) -> Keyframes:
        """Stamps (k,) and poses (k, 3) of the keyframes, with covariances (k, 3, 3) in each pose's own frame."""
        return Keyframes.of(self.finished)

    @property
    def interpretations(self) -> list[str]:
        """How the recording was read, and what of it was corrected, as lines of text."""
        return list(self.facts["interpretations"])

    @property
    def doubts(self) -> list[str]:
        """What is probably wrong with the recording or its sensors, as lines of text."""
        return list(self.facts["doubts"])

    @property
    def summary(self) -> dict[str, Any]:
        """Counts, learned values, loop decisions and suspects, as in `summary.json` under `slam`."""
        return self.finished.summary

    def wall_map(self) -> WallMap:
        """Return the walls with their joint covariance. Raises MapError if it is not determined."""
        return settled_wall_map(self.slam.slam_state.mapper)

    def rooms(self) -> list[Room]:
        """Return the closed rooms in which the robot was, largest first."""
        return find_rooms(self.wall_map())

    def measurements(self) -> list[Measurement]:
        """Return lengths, widths, angles and areas with standard deviations, as `wclm measure` does."""
        wall_map = self.wall_map()
        return measure_map(wall_map, find_rooms(wall_map))

    def occupancy(self, resolution: float = 0.05) -> Occupancy:
        """Return the occupancy grid of all scans, with cells of `resolution` metres, as `wclm map --format pgm` does.

        `slam.io.exports.write_pgm` and `write_pgm_yaml` write it for ROS. Raises MapError if the grid would become too
        large.
        """
        from .io.exports import OccupancyGrid, place_scans

        grid = OccupancyGrid(resolution)
        grid.add_all(place_scans(self.source, self.trajectory, self.slam.config))
        return grid.occupancy()

    def factor_graph(self) -> tuple[Any, Any]:
        """Return copies of the graph (gtsam.NonlinearFactorGraph) and of its estimate (gtsam.Values), for own factors.

        The pose of keyframe 5 has the key `gtsam.symbol("x", 5)`, the frame of wall 5 "l", the position of corner 5
        "c". Covariances of this graph are smaller than the published ones: see docs/mathematics.md.
        """
        return self.slam.slam_state.mapper.graph.factors_and_values()

    def plot(self, path: Path | str) -> None:
        """Draw map and path into a PNG file, as `wclm run --plot` does; needs matplotlib. Raises OutputError."""
        from .visualisation.plots import plot_map

        if Path(path).suffix != ".png":
            raise OutputError(f"{path}: the name must end with .png")
        odometry = self.odometry if len(self.odometry) else None
        truth = None if self.truth is None else self.truth.poses
        plot_map(
            Path(path), self.walls, self.corners, [self.trajectory], title=self.name, odometry=odometry, truth=truth
        )

    def save(self, directory: Path | str, *, overwrite: bool = False) -> None:
        """Write the output directory, as `wclm run --no-review` does: all commands read it. See `save_run`."""
        from .io.sessions import Recording
        from .io.sessions.records import to_pose

        first, last = float(self.stamps[0]), float(self.stamps[-1])
        recording = Recording(
            name=self.name,
            path=self.reopen,
            first=first,
            last=last,
            recorded_stamps=self.source.report.recorded_stamps,
            settings=self.slam.config,
            lidars=[to_pose(mount) for mount in self.slam.lidar_mounts],
        )
        save_run(
            self.slam,
            self.finished,
            directory,
            name=self.name,
            recording=recording,
            config=self.config,
            facts=self.facts,
            overwrite=overwrite,
        )

    def svg(self, measurements: Sequence[Measurement] = ()) -> str:
        """Return a drawing of map and path in the scale 1 : 100, with dimension lines of measurements, as SVG."""
        summary = {"recording": self.name, "slam": self.summary}
        results = RunResults(Path(), self.walls, self.corners, self.trajectory, summary, self.keyframes)
        return svg_text(results, MeasuredMap(measurements))

    def _repr_svg_(self) -> str:
        """Return the drawing, for notebooks."""
        return self.svg()

    def _repr_html_(self) -> str:
        """Return a table of the most important figures and the drawing, for notebooks."""
        loops, suspects = self.summary["loops"], self.summary["suspects"]
        assert isinstance(loops, dict)
        assert isinstance(suspects, list)
        rows = {
            "recording": self.name,
            "map": self._sizes,
            "path": f"{self.trajectory.length:.1f} m in {self.stamps[-1] - self.stamps[0]:.0f} s",
            "loops closed": str(loops["accepted"]),
            "suspects": "; ".join(one["text"] for one in suspects) or "none",
            "doubts": "; ".join(self.doubts) or "none",
        }
        cells = "".join(f"<tr><th>{name}</th><td>{escape(text)}</td></tr>" for name, text in rows.items())
        # As an image, the drawing's styles do not affect the page.
        picture = b64encode(self.svg().encode()).decode()
        return f'<table>{cells}</table><img src="data:image/svg+xml;base64,{picture}" style="max-width: 100%">'

    def __repr__(self) -> str:
        return f"<{self.name}: {self._sizes}, {self.trajectory.length:.1f} m driven>"

    @property
    def _sizes(self) -> str:
        return f"{counted(len(self.walls), 'wall')}, {counted(len(self.corners), 'corner')}"


def run(
    recording: Path | str, config: Config | None = None, *, refine: bool = False, sinks: Sequence[Sink] = ()
) -> MappedRecording:
    """Map a recording, a bag or a simulation, as `wclm run` does, without writing files.

    recording  path, or a specification like `sim:office?seed=3`: see `drivers.open`
    config     settings, also of the topics of the lidars; a delay of the lidar that the recording shows is compensated
               if none is set, and a recording without odometry, or with one that is of no use, is mapped without it
    refine     refine the whole map offline: more accurate, and slower
    sinks      receive the events of the pipeline

    Raises SlamError, with one line that names the place, if the recording cannot be read or mapped.
    """
    config = config or Config()
    source, reason = open_to_map(recording, config)
    if reason is not None:
        config = config.without_odometry()
    used, timing, second = timed(source, config)
    slam, facts = Slam(used, sinks, refine=refine), RecordingFacts(timing, second)
    odometry: list[se2.Pose] = []
    truth: list[GroundTruth] = []
    first = np.inf
    for message in source:
        facts.add(message)
        first = min(first, message.stamp)
        if isinstance(message, Odometry):
            odometry.append(message.pose)
        elif isinstance(message, GroundTruth):
            truth.append(message)
        slam.add(message)
    try:
        finished = slam.finish()
    except MapError as error:
        raise MapError(f"{source.name}: {error}") from error
    return MappedRecording(
        name=source.name,
        finished=finished,
        odometry=odometry_path(finished, first, np.array(odometry)) if odometry else np.zeros((0, 3)),
        truth=_true_path(finished, truth, used),
        slam=slam,
        source=source,
        reopen=recording_to_reopen(str(recording)),
        config=config,
        facts=_with_reason(facts.figures(source.report), reason),
    )


def _with_reason(facts: dict[str, Any], reason: str | None) -> dict[str, Any]:
    """Return facts on a recording with the reason why it was mapped by the scans alone, if it was."""
    if reason is None:
        return facts
    return facts | {"interpretations": [*facts["interpretations"], f"{reason}; mapped by the scans alone"]}


def odometry_path(finished: Finished, first: float, poses: Floats) -> Floats:
    """Return the odometry poses (m, 3) of a run that began at the stamp `first`, in the map: from the same start."""
    start = min(int(np.searchsorted(finished.stamps, first)), len(finished.poses) - 1)
    return se2.compose(finished.poses[start], se2.between(poses[0], poses))


def _true_path(finished: Finished, truth: Sequence[GroundTruth], config: Config) -> Trajectory | None:
    """Return the true path in the map; None if there is none at the time of the path."""
    if not truth:
        return None
    stated = Trajectory(np.array([t.stamp for t in truth]), np.array([t.pose for t in truth]))
    return score_true_path(Trajectory(finished.stamps, finished.poses), stated, config.lidar.delay)[1]
