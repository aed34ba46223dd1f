"""Map and path of a recording as one object, which displays itself in a notebook, and measures and draws itself."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from html import escape
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers.arguments import check_items, check_type, path_of
from drivers.immutable import immutable
from drivers.messages import Source

from .config import Config
from .errors import OutputError
from .events import Finished
from .formatting import counted
from .geometry.segments import Floats
from .io.exports.svg import svg_text
from .io.recordings import open_recording
from .io.run_results import RunResults
from .io.tum import Trajectory
from .io.wall_maps import settled_wall_map
from .mapping.map_features import Keyframes, MapCorners, MapWalls
from .measuring.map_measurements import measure_map
from .measuring.measured_map import MeasuredMap
from .measuring.measurement import Measurement
from .measuring.rooms import Room, find_rooms
from .measuring.wall_map import WallMap
from .offline.map_diff.plan_report import PlanReport
from .pipeline import Slam
from .run_saving import save_run

if TYPE_CHECKING:
    from .io.exports import Occupancy
    from .io.sessions import Recording


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
    facts     on the recording, as in `summary.json`: gaps, timing, interpretations, doubts, warnings, plan
    shift     seconds that were added to stamps during the run, so that they follow those of the session that it used
    on_plan   comparison of the map with the plan that it was made with; None without a plan
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
    shift: float = 0.0
    on_plan: PlanReport | None = None

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
        """Stamps (n,) of the path, seconds: those of the recording, or of the session if that is continued."""
        return self.finished.stamps if self.slam.extends_map else self.finished.stamps - self.shift

    @property
    def path(self) -> Floats:
        """Poses (n, 3) of the base in the map: [x, y, heading], metres and radians; first those of a session that was
        continued, while a run that only localises has none but its own.
        """
        return self.finished.poses

    @property
    def trajectory(self) -> Trajectory:
        """Path with its stamps."""
        return Trajectory(self.stamps, self.path)

    @property
    def keyframes(self) -> Keyframes:
        """Keyframes with covariances."""
        return self.finished.keyframes

    @property
    def interpretations(self) -> list[str]:
        """How the recording was read, and what of it was corrected, as lines of text."""
        return list(self.facts["interpretations"])

    @property
    def doubts(self) -> list[str]:
        """What is probably wrong with the recording or its sensors, as lines of text."""
        return list(self.facts["doubts"])

    @property
    def warnings(self) -> list[str]:
        """What went wrong during the run, such as a lost pose or a plan that was not recognised, as lines of text."""
        return list(self.facts["warnings"])

    @property
    def plan_differences(self) -> list[str]:
        """Differences from the plan, as lines of text; none if the map was not recognised in it (`facts["plan"]`)."""
        return list(self.facts.get("plan", {}).get("differences", ()))

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
        large, or if a recording of a session that was continued is missing.
        """
        from .io.exports import OccupancyGrid, place_scans

        check_type("resolution", resolution, Real, "a number of metres")
        grid = OccupancyGrid(resolution)
        earlier = [] if not self.slam.extends_map else self.slam.session.recordings
        if earlier:
            recordings = [one.model_dump() for one in [*earlier, self._recording]]
            grid.add_all(place_scans(open_recording(self._results({"recordings": recordings})), self.trajectory))
        else:
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

        file = path_of("path", path)
        if file.suffix != ".png":
            raise OutputError(f"{path}: the name must end with .png")
        odometry = self.odometry if len(self.odometry) else None
        truth = None if self.truth is None else self.truth.poses
        plot_map(file, self.walls, self.corners, [self.trajectory], title=self.name, odometry=odometry, truth=truth)

    def save(self, directory: Path | str, *, overwrite: bool = False) -> None:
        """Write the output directory, as `wclm run --no-review` does: all commands read it. See `save_run`."""
        save_run(
            self.slam,
            self.finished,
            directory,
            name=self.name,
            recording=self._recording,
            config=self.config,
            facts=self.facts,
            on_plan=self.on_plan,
            overwrite=overwrite,
        )

    def svg(self, measurements: Sequence[Measurement] = ()) -> str:
        """Return a drawing of map and path in the scale 1 : 100, with dimension lines of measurements, as SVG."""
        check_items("measurements", measurements, Measurement, "Measurement")
        results = self._results({"recording": self.name, "slam": self.summary})
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

    @property
    def _recording(self) -> Recording:
        """Entry of the recording in a session."""
        from .io.sessions import Recording
        from .io.sessions.records import to_pose

        earlier = self.slam.session.recordings
        stamps = self.finished.stamps
        own = stamps[stamps > max((one.last for one in earlier), default=-np.inf)]
        return Recording(
            name=self.name,
            path=self.reopen,
            shift=self.shift,
            first=float(own[0]),
            last=float(own[-1]),
            recorded_stamps=self.source.report.recorded_stamps,
            settings=self.slam.config,
            lidars=[to_pose(mount) for mount in self.slam.lidar_mounts],
        )

    def _results(self, summary: dict[str, Any]) -> RunResults:
        return RunResults(Path(), self.walls, self.corners, self.trajectory, summary, self.keyframes)

    def __repr__(self) -> str:
        return f"<{self.name}: {self._sizes}, {self.trajectory.length:.1f} m driven>"

    @property
    def _sizes(self) -> str:
        return f"{counted(len(self.walls), 'wall')}, {counted(len(self.corners), 'corner')}"
