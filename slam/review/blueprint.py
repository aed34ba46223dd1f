"""How the viewer lays the log out: the whole map and a close-up of the robot, text at the right, plots below."""

from __future__ import annotations

import math

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ..segments import Floats
from .colours import BACKGROUND, GRID

FIELD_OF_VIEW = math.radians(55.0)  # vertical, of the viewer's eye; there is no orthographic one
MAP_ASPECT = 1.15  # width of the map's panel by its height, on a wide screen
MARGIN = 1.1
CLOSE_UP = 12.0  # metres across the close-up


def eye_distance(width: float, height: float) -> float:
    """How far above the map the eye must be to see `width` by `height` metres in the map's panel."""
    return MARGIN * max(height, width / MAP_ASPECT, 1.0) / (2 * math.tan(FIELD_OF_VIEW / 2))


def grid_spacing(size: float) -> float:
    """Metres between the grid's lines for a map of `size` metres: 1, 5, 10, 50, ... so that at most 30 are seen."""
    spacing, factors = 1.0, (5.0, 2.0)
    step = 0
    while size / spacing > 30:
        spacing *= factors[step % 2]
        step += 1
    return spacing


def layout(low: Floats, high: Floats, *, truth: bool, usual_time: float | None = None) -> rrb.Blueprint:
    """The layout for a map in the box from `low` (2,) to `high` (2,), metres.

    `truth` adds a plot of errors; `usual_time` is what most keyframes take, milliseconds: the plot of times shows twice
    that, because the first keyframe, which waits for compilers, would flatten all others.
    """
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(_map(low, high), _close_up(), _texts(), column_shares=[5, 4, 3]),
            _plots(truth=truth, usual_time=usual_time),
            row_shares=[3, 1.2],
        ),
        rrb.TimePanel(state="collapsed", timeline="keyframe", play_state="following"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def _map(low: Floats, high: Floats) -> rrb.Spatial3DView:
    centre = 0.5 * (low + high)
    width, height = high - low
    distance = eye_distance(float(width), float(height))
    return rrb.Spatial3DView(
        origin="world",
        contents=["$origin/**", "- $origin/map/wall_sigma"],  # the bands would double every wall
        name="Map",
        eye_controls=_eye_above(centre, distance),
        line_grid=_grid(grid_spacing(float(max(width, height)))),
        background=BACKGROUND,
    )


def _close_up() -> rrb.Spatial3DView:
    # The origin moves with the robot and does not turn. An eye that tracks an entity would not stay above it.
    return rrb.Spatial3DView(
        origin="world/here",
        contents=["/world/**", "- /world/odometry/**"],
        name="Close-up of the robot",
        eye_controls=_eye_above(np.zeros(2), eye_distance(CLOSE_UP, CLOSE_UP)),
        line_grid=_grid(1.0),
        background=BACKGROUND,
        overrides={"world/features/segments": [rr.LineStrips3D.from_fields(show_labels=True).visualizer()]},
    )


def _eye_above(centre: Floats, distance: float) -> rrb.EyeControls3D:
    x, y = float(centre[0]), float(centre[1])
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=[x, y - 1e-3 * distance, distance],  # straight down would leave no way up
        look_target=[x, y, 0.0],
        eye_up=[0.0, 1.0, 0.0],
    )


def _grid(spacing: float) -> rrb.LineGrid3D:
    return rrb.LineGrid3D(visible=True, spacing=spacing, color=GRID)


def _texts() -> rrb.Vertical:
    columns = rrb.TextLogColumns(timeline_columns=["keyframe"], text_log_columns=["loglevel", "body"])
    return rrb.Vertical(
        rrb.Tabs(
            rrb.TextDocumentView(origin="legend", name="Legend"),
            rrb.TextDocumentView(origin="keyframe", name="Keyframe"),
            rrb.TextDocumentView(origin="config", name="Settings"),
            rrb.TextDocumentView(origin="summary", name="Summary"),
            active_tab=0,
        ),
        rrb.TextLogView(origin="log", name="Log", columns=columns),
        row_shares=[3, 2],
    )


def _plots(*, truth: bool, usual_time: float | None) -> rrb.Horizontal:
    share = rrb.ScalarAxis(range=(0.0, 1.05), zoom_lock=True)
    times = None if usual_time is None else rrb.ScalarAxis(range=(0.0, 2 * usual_time))
    plots: list[rrb.TimeSeriesView | rrb.Tabs] = [
        _plot("explained", "Explained by the map", axis=share),
        _plot("sigma", "Pose sigma"),
        rrb.Tabs(_plot("association", "Largest d² of a match"), _plot("chi2", "chi²"), active_tab=0),
        _plot("time", "Time per keyframe [ms]", axis=times),
        _plot("counts", "Counts"),
    ]
    if truth:
        plots.insert(0, _plot("error", "Error against the truth"))
    return rrb.Horizontal(*plots)


def _plot(group: str, name: str, axis: rrb.ScalarAxis | None = None) -> rrb.TimeSeriesView:
    legend = rrb.PlotLegend(rrb.Corner2D.LeftTop)
    always = rr.TimeRangeBoundary.infinite()
    return rrb.TimeSeriesView(
        origin=f"metrics/{group}",
        name=name,
        axis_x=rrb.TimeAxis(view_range=rr.TimeRange(start=always, end=always)),
        axis_y=axis,
        plot_legend=legend,
    )
