"""Define the viewer's layout: map, close-up, loop closures, text panels, and plots."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ...geometry.segments import Floats
from .colours import BACKGROUND, GRID
from .status_layer import ENTITY as STATUS_ENTITY

FIELD_OF_VIEW = math.radians(55.0)  # vertical, of the viewer's eye; Rerun has no orthographic projection
MAP_ASPECT, CORNER_ASPECT = 1.15, 1.6  # width / height of the map's panel and of the smaller panels
VIEW_MARGIN = 1.1  # shown size / size of the map
CLOSE_UP_SIZE = 9.0  # metres shown in the close-up
COMPARED_SIZE = 14.0  # metres shown of the compared points
MAX_VIEW_GRID_LINES = 30  # along one side of the map
TABLE_COLUMNS = ("at_keyframe", "old_keyframe", "reason", "status")  # the viewer sorts them


def eye_distance(width: float, height: float, aspect: float = MAP_ASPECT) -> float:
    """Return the height of the eye, metres, at which a panel shows `width` by `height` metres."""
    return VIEW_MARGIN * max(height, width / aspect, 1.0) / (2 * math.tan(FIELD_OF_VIEW / 2))


def grid_spacing(size: float) -> float:
    """Return the grid spacing for a map of `size` metres: 1, 5, 10, 50, ... metres, at most 30 lines."""
    spacing, factors = 1.0, (5.0, 2.0)
    step = 0
    while size / spacing > MAX_VIEW_GRID_LINES:
        spacing *= factors[step % 2]
        step += 1
    return spacing


@dataclass(frozen=True, slots=True, eq=False)
class Extent:
    """Content of a log, as far as the layout depends on it.

    low, high     (2,) corners of the box around the map, metres
    truth         True if there is ground truth
    typical_time  milliseconds that most keyframes take; the time plot shows twice that, because the first keyframe,
                  which waits for the compiler, would flatten all others
    """

    low: Floats
    high: Floats
    truth: bool = False
    typical_time: float | None = None


def layout(extent: Extent) -> rrb.Blueprint:
    """Return the layout for one log."""
    panels = _Panels("", extent)
    middle = rrb.Vertical(panels.close_up(), panels.closures(), row_shares=[1, 1])
    plots = rrb.Horizontal(
        *(rrb.Tabs(*views, active_tab=0) for views in panels.plots()),
        panels.candidates(),
        column_shares=[2, 2, 2, 2, 3],
    )
    top = rrb.Horizontal(panels.map(), middle, panels.texts(), column_shares=[5, 3, 3])
    return _whole(rrb.Vertical(top, plots, row_shares=[3, 1]))


def side_by_side(extents: Mapping[str, Extent]) -> rrb.Blueprint:
    """Return the layout for several logs in one recording, a column each; the keys are the logs' root entities."""
    columns = []
    for root, extent in extents.items():
        panels = _Panels(f"{root}/", extent)
        views = [view for together in panels.plots() for view in together]
        plots = rrb.Tabs(*views, panels.candidates(), active_tab=0)
        closures = panels.closures(panels.close_up())
        columns.append(rrb.Vertical(panels.map(name=root), closures, panels.texts(), plots, row_shares=[4, 3, 3, 2]))
    return _whole(rrb.Horizontal(*columns))


def _whole(views: rrb.Vertical | rrb.Horizontal) -> rrb.Blueprint:
    return rrb.Blueprint(
        views,
        rrb.TimePanel(state="collapsed", timeline="keyframe", play_state="following"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


class _Panels:
    """Panels of one log whose entities are below `root`."""

    def __init__(self, root: str, extent: Extent) -> None:
        self._root, self._extent = root, extent

    def map(self, name: str = "Map") -> rrb.Spatial3DView:
        """Return the view of the whole map."""
        # Bands would double every wall; the map before the correction and the factors would cover it.
        hidden = ("map/wall_sigma", "before/**", "shift", "factors/**", "features/gated_out")
        contents = ["$origin/**", *(f"- $origin/{entity}" for entity in hidden)]
        return self._from_above(name, contents, MAP_ASPECT)

    def close_up(self) -> rrb.Spatial3DView:
        """Return the view of the robot's surroundings."""
        # The origin moves with the robot without turning. An eye that tracks an entity would not stay above it.
        hidden = ("odometry/**", "before/**", "shift", "factors/**", "loops/**", "path/keyframes")
        return rrb.Spatial3DView(
            origin=f"{self._root}world/here",
            contents=[f"/{self._root}world/**", *(f"- /{self._root}world/{name}" for name in hidden)],
            name="Close-up of the robot",
            eye_controls=_eye_above(np.zeros(2), eye_distance(CLOSE_UP_SIZE, CLOSE_UP_SIZE, CORNER_ASPECT)),
            line_grid=_grid(1.0),
            background=BACKGROUND,
        )

    def closures(self, *first: rrb.Spatial3DView) -> rrb.Tabs:
        """Return the views of corrections, compared points, misfits and the factor graph."""
        before = ("before/**", "shift", "map/walls", "path/estimate", "path/recent", "loops/**", "robot/**")
        factors = ("factors/**", "map/walls", "robot/**")
        compared = rrb.Spatial3DView(
            origin=f"{self._root}compared_points",
            name="Compared points",
            eye_controls=_eye_above(np.zeros(2), eye_distance(COMPARED_SIZE, COMPARED_SIZE, CORNER_ASPECT)),
            line_grid=_grid(1.0),
            background=BACKGROUND,
        )
        return rrb.Tabs(
            *first,
            self._from_above("Before / after", [f"$origin/{entity}" for entity in before], CORNER_ASPECT),
            compared,
            self._from_above("Misfits", [f"$origin/{entity}" for entity in factors], CORNER_ASPECT),
            rrb.GraphView(origin=f"{self._root}graph", name="Factor graph"),
            active_tab=0,
        )

    def texts(self) -> rrb.Vertical:
        """Return the text documents and the text log."""
        documents = {
            "loops/report": "Last loop",
            "legend": "Legend",
            "keyframe": "Keyframe",
            "residuals/report": "Residuals",
            "config": "Settings",
            "summary": "Summary",
        }
        views = [rrb.TextDocumentView(origin=self._root + entity, name=name) for entity, name in documents.items()]
        columns = rrb.TextLogColumns(timeline_columns=["keyframe"], text_log_columns=["loglevel", "body"])
        rows = rrb.TextLogRows(filter_by_log_level=["ERROR", "WARN", "INFO", "DEBUG"])
        log = rrb.TextLogView(origin=f"{self._root}log", name="Log", columns=columns, rows=rows)
        return rrb.Vertical(rrb.Tabs(*views, active_tab=1), log, row_shares=[3, 2])

    def plots(self) -> list[list[rrb.View]]:
        """Return the plots in groups of tabs; the first of each group is shown."""
        share = rrb.ScalarAxis(range=(0.0, 1.05), zoom_lock=True)
        typical = self._extent.typical_time
        times = None if typical is None else rrb.ScalarAxis(range=(0.0, 2 * typical))
        first = [self._plot("error", "Pose error")] if self._extent.truth else []
        return [
            [*first, self._plot("overlap_ratio", "Overlap ratio", axis=share)],
            [
                self._plot("chi2", "chi² and loops"),
                self._plot("fit", "Misfit by kind"),
                self._plot("association", "Largest d² of a match"),
            ],
            [
                self._plot("sigma", "Pose sigma"),
                rrb.StateTimelineView(origin=f"{self._root}{STATUS_ENTITY}", name="Status"),
            ],
            [self._plot("time", "Time per keyframe [ms]", axis=times), self._plot("counts", "Counts")],
        ]

    def candidates(self) -> rrb.DataframeView:
        """Return the table of all loop decisions."""
        entity = f"/{self._root}loops/decisions"
        chosen: list[Any] = ["candidate", *(f"{entity}:{column}" for column in TABLE_COLUMNS)]
        query = rrb.archetypes.DataframeQuery(timeline="candidate", select=chosen)
        return rrb.DataframeView(origin=entity, name="Loop candidates", query=query)

    def _from_above(self, name: str, contents: list[str], aspect: float) -> rrb.Spatial3DView:
        low, high = self._extent.low, self._extent.high
        width, height = (float(size) for size in high - low)
        return rrb.Spatial3DView(
            origin=f"{self._root}world",
            contents=contents,
            name=name,
            eye_controls=_eye_above(0.5 * (low + high), eye_distance(width, height, aspect)),
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
