"""Define the viewer's layout: map, close-up, loop closures, text panels, and plots."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from drivers.immutable import immutable

from ...geometry.segments import Floats
from .colours import BACKGROUND, GRID
from .loop_layer import TABLE, TABLE_COLUMNS
from .status_layer import ENTITY as STATUS_ENTITY
from .timelines import CANDIDATE, CLOSURE, KEYFRAME, SENSOR_TIME

FIELD_OF_VIEW = math.radians(55.0)  # vertical, of the viewer's eye; Rerun has no orthographic projection
MAP_ASPECT, WIDE_ASPECT = 1.0, 2.0  # width / height of the panels of the map and of those below
VIEW_MARGIN = 1.1  # shown size / size of the map
CLOSE_UP_SIZE = 9.0  # metres shown in the close-up
COMPARED_SIZE = 14.0  # metres shown of the compared points
MAX_VIEW_GRID_LINES = 30  # along one side of the map


def eye_distance(width: float, height: float, aspect: float) -> float:
    """Return the height of the eye, metres, at which a panel shows `width` by `height` metres.

    aspect  width / height of the panel
    """
    return VIEW_MARGIN * max(height, width / aspect, 1.0) / (2 * math.tan(FIELD_OF_VIEW / 2))


def grid_spacing(size: float) -> float:
    """Return the grid spacing for a map of `size` metres: 1, 5, 10, 50, ... metres, at most 30 lines."""
    spacing, factors = 1.0, (5.0, 2.0)
    step = 0
    while size / spacing > MAX_VIEW_GRID_LINES:
        spacing *= factors[step % 2]
        step += 1
    return spacing


@immutable
class Extent:
    """Content of a log, as far as the layout depends on it.

    low, high     (2,) corners of the box around the map, metres
    truth         True if there is ground truth
    decided       True if there are loop decisions; the viewer warns of a table without rows
    corrected     True if a loop was closed or a closure retracted
    fitted        True if chi² has several values, and its plot is a line; after offline estimation it has one
    running       True if the run goes on, so that a loop may be closed yet
    mapped        True if the run has added several keyframes; a robot that is only localised adds few or none
    typical_time  milliseconds that most keyframes take; the time plot shows twice that, because the first keyframe,
                  which waits for the compiler, would flatten all others
    """

    low: Floats
    high: Floats
    truth: bool = False
    typical_time: float | None = None
    decided: bool = False
    corrected: bool = False
    fitted: bool = True
    mapped: bool = True
    running: bool = False

    @property
    def compares(self) -> bool:
        """True if the map before and after a correction is to be shown."""
        return self.corrected or (self.decided and self.running)


def layout(extent: Extent) -> rrb.Blueprint:
    """Return the layout for one log: opened at its last correction, else following the last keyframe, or the last scan
    if there are no keyframes."""
    panels = _Panels("", extent)
    # On the timeline of corrections a plot has one value for each, so other panels are in front there.
    plots_of_path, plots_of_fit = panels.plots()
    fitted = extent.fitted and extent.mapped
    compared = panels.compared_points()
    shown = 0 if extent.mapped else len(plots_of_path) - 1  # the last one is the status, the only one between keyframes
    left = rrb.Tabs(*compared, *plots_of_path, active_tab=0 if extent.corrected else len(compared) + shown)
    right = rrb.Tabs(panels.histogram(), *plots_of_fit, active_tab=1 if fitted and not extent.corrected else 0)
    rows = rrb.Tabs(panels.log(), *panels.decisions(), active_tab=0)
    plots = rrb.Horizontal(left, right, rows, column_shares=[3, 3, 5])
    texts = rrb.Tabs(*panels.documents(), active_tab=1 if extent.decided and not extent.corrected else 0)
    top = rrb.Horizontal(panels.maps(), panels.details(), texts, column_shares=[4, 4, 3])
    by_progress = KEYFRAME if extent.mapped else SENSOR_TIME
    return _whole(rrb.Vertical(top, plots, row_shares=[5, 2]), CLOSURE if extent.corrected else by_progress)


def side_by_side(extents: Mapping[str, Extent]) -> rrb.Blueprint:
    """Return the layout for several logs in one recording, a column each; the keys are the logs' root entities."""
    columns = []
    for root, extent in extents.items():
        panels = _Panels(f"{root}/", extent, WIDE_ASPECT)
        views = [view for together in panels.plots() for view in together]
        views += [*panels.compared_points(), panels.histogram()]
        plots = rrb.Tabs(*views, *panels.decisions(), active_tab=0)
        texts = rrb.Tabs(panels.log(), *panels.documents(), active_tab=0)
        columns.append(rrb.Vertical(panels.maps(root), panels.details(), texts, plots, row_shares=[5, 5, 3, 3]))
    return _whole(rrb.Horizontal(*columns), KEYFRAME)


def _whole(views: rrb.Vertical | rrb.Horizontal, timeline: str) -> rrb.Blueprint:
    # Following shows the last step of a timeline. That of CLOSURE is the last correction, not the end of the run.
    return rrb.Blueprint(
        views,
        rrb.TimePanel(state="collapsed", timeline=timeline, play_state="following"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


class _Panels:
    """Panels of one log whose entities are below `root`."""

    def __init__(self, root: str, extent: Extent, aspect: float = MAP_ASPECT) -> None:
        """`aspect` is width / height of the panels of the map."""
        self._root, self._extent, self._aspect = root, extent, aspect

    def maps(self, name: str = "Map") -> rrb.Tabs:
        """Return the views of the whole map: alone, with all scans behind it, and with the confidence map."""
        # Bands would double every wall; the map before the correction and the factors would cover it.
        hidden = ["map/wall_sigma", "before/**", "shift", "factors/**", "features/gated_out", "last_scans/**"]
        hidden += ["confidence/**"]
        alone = ["$origin/**", *(f"- $origin/{entity}" for entity in [*hidden, "scans/**"])]
        with_scans = ["$origin/**", *(f"- $origin/{entity}" for entity in [*hidden, "map/corner_sigma", "grid"])]
        confidence = ("confidence/**", "map/walls", "path/estimate", "grid")
        views = (
            self._from_above(name, alone),
            self._from_above(f"{name} and scans", with_scans),
            self._from_above("Confidence", [f"$origin/{entity}" for entity in confidence]),
        )
        return rrb.Tabs(*views, active_tab=0)

    def close_up(self) -> rrb.Spatial3DView:
        """Return the view of the robot's surroundings."""
        # The origin moves with the robot without turning. An eye that tracks an entity would not stay above it.
        below = ("odometry/**", "before/**", "shift", "factors/**", "loops/**", "path/keyframes")
        hidden = (*below, "scans/**", "confidence/**", "grid")
        return rrb.Spatial3DView(
            origin=f"{self._root}world/here",
            contents=[f"/{self._root}world/**", *(f"- /{self._root}world/{name}" for name in hidden)],
            name="Close-up of the robot",
            eye_controls=_eye_above(np.zeros(2), eye_distance(CLOSE_UP_SIZE, CLOSE_UP_SIZE, self._aspect)),
            line_grid=_grid(1.0),
            background=BACKGROUND,
        )

    def details(self) -> rrb.Tabs:
        """Return the views of corrections, the robot's surroundings and factors."""
        before = ("before/**", "shift", "map/walls", "path/estimate", "path/recent", "loops/**", "robot/**")
        factors = ("factors/**", "map/walls", "robot/**")
        compared = [self._from_above("Before / after", [f"$origin/{entity}" for entity in before])]
        return rrb.Tabs(
            *(compared if self._extent.compares else []),
            self.close_up(),
            self._from_above("Factors", [f"$origin/{entity}" for entity in factors]),
            rrb.GraphView(origin=f"{self._root}graph", name="Graph"),
            active_tab=1 if self._extent.compares and not self._extent.corrected else 0,
        )

    def documents(self) -> list[rrb.TextDocumentView]:
        """Return the views of the text documents; the first one is that of the last loop if there is any."""
        documents = {"loops/report": "Last loop"} if self._extent.decided else {}
        documents |= {
            "legend": "Legend",
            "keyframe": "Keyframe",
            "residuals/report": "Residuals",
            "config": "Settings",
            "summary": "Summary",
        }
        return [rrb.TextDocumentView(origin=self._root + entity, name=name) for entity, name in documents.items()]

    def log(self) -> rrb.TextLogView:
        """Return the view of the text log."""
        # Without columns for other timelines, that of the selected one is shown.
        columns = rrb.TextLogColumns(timeline_columns=[], text_log_columns=["loglevel", "body"])
        rows = rrb.TextLogRows(filter_by_log_level=["ERROR", "WARN", "INFO", "DEBUG"])
        return rrb.TextLogView(origin=f"{self._root}log", name="Log", columns=columns, rows=rows)

    def plots(self) -> list[list[rrb.View]]:
        """Return the plots in groups of tabs; the first of each group is shown."""
        share = rrb.ScalarAxis(range=(0.0, 1.05), zoom_lock=True)
        typical = self._extent.typical_time
        times = None if typical is None else rrb.ScalarAxis(range=(0.0, 2 * typical))
        first = [self._plot("error", "Pose error")] if self._extent.truth else []
        return [
            [
                *first,
                self._plot("sigma", "Pose sigma"),
                self._plot("overlap_ratio", "Overlap", axis=share),
                rrb.StateTimelineView(origin=f"{self._root}{STATUS_ENTITY}", name="Status"),
            ],
            [
                self._plot("chi2", "chi² / dof"),
                self._plot("fit", "By kind"),
                self._plot("association", "Largest d²"),
                self._plot("time", "Time [ms]", axis=times),
                self._plot("counts", "Counts"),
            ],
        ]

    def compared_points(self) -> list[rrb.Spatial3DView]:
        """Return the view of the points that the last decision compared; nothing if there is no decision."""
        if not self._extent.decided:
            return []
        view = rrb.Spatial3DView(
            origin=f"{self._root}compared_points",
            name="Compared points",
            eye_controls=_eye_above(np.zeros(2), eye_distance(COMPARED_SIZE, COMPARED_SIZE, WIDE_ASPECT)),
            line_grid=_grid(1.0),
            background=BACKGROUND,
        )
        return [view]

    def histogram(self) -> rrb.BarChartView:
        """Return the view of the distribution of the residuals."""
        legend = rrb.PlotLegend(rrb.Corner2D.RightTop)
        origin, name = f"{self._root}residuals/histogram", "Residuals of walls [σ], %"
        return rrb.BarChartView(origin=origin, name=name, plot_legend=legend)

    def decisions(self) -> list[rrb.DataframeView]:
        """Return the table of all loop decisions; nothing if there is none."""
        if not self._extent.decided:
            return []
        entity = f"/{self._root}{TABLE}"
        columns: list[Any] = [CANDIDATE, *(f"{entity}:{column}" for column in TABLE_COLUMNS)]
        query = rrb.archetypes.DataframeQuery(timeline=CANDIDATE, select=columns)
        return [rrb.DataframeView(origin=entity, name="Loop decisions", query=query)]

    def _from_above(self, name: str, contents: list[str]) -> rrb.Spatial3DView:
        low, high = self._extent.low, self._extent.high
        width, height = (float(size) for size in high - low)
        return rrb.Spatial3DView(
            origin=f"{self._root}world",
            contents=contents,
            name=name,
            eye_controls=_eye_above(0.5 * (low + high), eye_distance(width, height, self._aspect)),
            line_grid=_grid(grid_spacing(max(width, height))),
            background=BACKGROUND,
        )

    def _plot(self, group: str, name: str, axis: rrb.ScalarAxis | None = None) -> rrb.TimeSeriesView:
        always = rr.TimeRangeBoundary.infinite()
        return rrb.TimeSeriesView(
            origin=f"{self._root}metrics/{group}",
            name=name,
            axis_x=rrb.TimeAxis(view_range=rr.TimeRange(start=always, end=always)),
            axis_y=axis,
            plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop),
        )


def _eye_above(centre: Floats, distance: float) -> rrb.EyeControls3D:
    x, y = float(centre[0]), float(centre[1])
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=[x, y - 1e-3 * distance, distance],  # looking straight down, the up direction would be undefined
        look_target=[x, y, 0.0],
        eye_up=[0.0, 1.0, 0.0],
    )


def _grid(spacing: float) -> rrb.LineGrid3D:
    return rrb.LineGrid3D(visible=True, spacing=spacing, color=GRID)
