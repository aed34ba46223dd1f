"""Draw the factor graph and its residuals: as lines in the map, as a graph of nodes and edges, and as a table."""

from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from ...events import GraphInspected
from ...geometry.segments import Floats, Integers
from ...graph.residuals import CORNER, GAUGE_PRIOR, ODOMETRY, WALL, WALL_EQUALITY, Residuals
from ...mapping.map_features import MapCorners, MapWalls
from . import colours
from .colours import Colour
from .documents import residual_report
from .rrd_writer import RrdWriter
from .shapes import Height, to_3d
from .time_series import TimeSeries

OUTLIER_GATE = 10.8
"""Squared Mahalanobis distance per degree of freedom beyond which a factor is drawn as an outlier: chi-square, 1 dof,
99.9 %."""
MISFIT_GATE = 4.0  # squared Mahalanobis distance per degree of freedom beyond which a factor is drawn
WORST_FACTORS = 12  # factors listed by name
LATEST_KEYFRAMES = 40  # keyframes in the graph view; more are neither readable nor laid out well by the viewer
GRAPH_SCALE = 60.0  # points per metre in the graph view, whose y axis points down

_NODE_COLOURS = {"x": colours.ESTIMATE, "L": colours.WALL, "C": colours.CORNER}
_THIN, _THICK = rr.Radius.ui_points(0.4), rr.Radius.ui_points(1.6)


class FactorGraphLayer:
    """Inspections of the factor graph, drawn over the map as last received."""

    def __init__(self, writer: RrdWriter, time_series: TimeSeries) -> None:
        self._writer, self._time_series = writer, time_series
        self._merged: list[tuple[int, int, int, bool]] = []  # keyframe, absorbed, kept, merged by a loop closure
        misfits = rr.LineStrips3D.from_fields(radii=_THIN, colors=colours.ODOMETRY)
        outliers = rr.LineStrips3D.from_fields(radii=_THICK, colors=colours.REJECTED, show_labels=True)
        writer.log_static("world/factors/misfits", misfits)
        writer.log_static("world/factors/outliers", outliers)

    def merge(self, keyframe: int, absorbed: int, kept: int, *, loop: bool) -> None:
        """Record that two walls were merged at a keyframe."""
        self._merged.append((keyframe, absorbed, kept, loop))

    def unmerge(self, keyframe: int) -> None:
        """Undo the merges from a keyframe on."""
        self._merged = [merged for merged in self._merged if merged[0] < keyframe]

    def log(self, event: GraphInspected, keyframes: Floats, lines: MapWalls, corners: MapCorners) -> None:
        """Log an inspection; keyframes (k, 3) and landmarks are the current estimate."""
        residuals = event.residuals
        if not len(residuals):
            return
        report = residual_report(residuals, WORST_FACTORS)
        self._writer.log("residuals/report", rr.TextDocument(report, media_type=rr.MediaType.MARKDOWN))
        worst = residuals.worst(WORST_FACTORS)
        if not len(worst):
            return
        row = rr.AnyValues(
            factor=[residuals.name(index) for index in worst.tolist()],
            kind=[residuals.kind[index] for index in worst.tolist()],
            squared=residuals.squared[worst],
            dof=residuals.dof[worst],
        )
        self._writer.log("residuals/worst", row)
        measured = ~residuals.is_kind(GAUGE_PRIOR)
        fits = {"all": _mean_per_dof(residuals, measured)}
        fits |= {
            kind: _mean_per_dof(residuals, residuals.is_kind(kind)) for kind in (ODOMETRY, WALL, CORNER, WALL_EQUALITY)
        }
        self._time_series.log("fit", fits)
        merged_into = {absorbed: kept for _, absorbed, kept, _ in self._merged}
        positions = _VariablePositions(keyframes, lines, corners, merged_into)
        self._log_in_map(residuals, positions)
        self._log_latest(residuals, positions)

    def _log_in_map(self, residuals: Residuals, positions: _VariablePositions) -> None:
        """Draw misfitting factors as lines between keyframes and landmarks, and label the outliers.

        All factors together would cover the map.
        """
        ends, misfit = positions.ends(residuals), residuals.squared / residuals.dof
        drawn = np.isfinite(ends).all(axis=(1, 2)) & (misfit > MISFIT_GATE)
        outlier = drawn & (misfit > OUTLIER_GATE)
        misfits = rr.LineStrips3D.from_fields(strips=to_3d(ends[drawn & ~outlier], Height.ODOMETRY))
        self._writer.log("world/factors/misfits", misfits)
        labels = [f"{residuals.name(k)} d²={residuals.squared[k]:.0f}" for k in np.flatnonzero(outlier).tolist()]
        outliers = rr.LineStrips3D.from_fields(strips=to_3d(ends[outlier], Height.LINK), labels=labels)
        self._writer.log("world/factors/outliers", outliers)

    def _log_latest(self, residuals: Residuals, positions: _VariablePositions) -> None:
        """Draw the last keyframes and their landmarks as nodes, and their factors as edges."""
        recent = positions.recent(residuals, LATEST_KEYFRAMES)
        ends = positions.ends(residuals)
        merged_by_loop = {positions.kept_wall(kept) for *_, kept, loop in self._merged if loop}
        nodes: dict[str, tuple[Floats, Colour]] = {}
        edges = []
        for index in np.flatnonzero(recent & np.isfinite(ends).all(axis=(1, 2))).tolist():
            names = positions.names(residuals, index)
            edges.append(names)
            for name, position in zip(names, ends[index], strict=True):
                shade = _NODE_COLOURS[name[0]]
                if name[0] == "L" and int(name[1:]) in merged_by_loop:
                    shade = colours.CLOSURE
                nodes[name] = position * [GRAPH_SCALE, -GRAPH_SCALE], shade
        drawn = rr.GraphNodes(
            list(nodes),
            positions=[position for position, _ in nodes.values()],
            colors=[shade for _, shade in nodes.values()],
            labels=list(nodes),
            radii=[4.0] * len(nodes),
        )
        self._writer.log("graph", drawn)
        self._writer.log("graph", rr.GraphEdges(edges, graph_type="undirected"))


class _VariablePositions:
    """Positions of the graph's variables in the map; a merged wall has the position of the wall it was merged into."""

    def __init__(self, keyframes: Floats, lines: MapWalls, corners: MapCorners, merged_into: dict[int, int]) -> None:
        self._keyframes, self._merged_into = keyframes, merged_into
        middles = lines.end_points().mean(axis=1).reshape(-1, 2)
        self._walls = _by_identity(lines.identity, middles)
        self._corners = _by_identity(corners.identity, corners.position.reshape(-1, 2))

    def kept_wall(self, wall: int) -> int:
        """Return the id of the wall that this one was merged into, else its own."""
        while wall in self._merged_into:
            wall = self._merged_into[wall]
        return wall

    def recent(self, residuals: Residuals, count: int) -> NDArray[np.bool_]:
        """Return a mask (n,) of the factors between two variables that belong to the last `count` keyframes."""
        oldest = len(self._keyframes) - count
        measured = residuals.is_kind(ODOMETRY) | residuals.is_kind(WALL) | residuals.is_kind(CORNER)
        latest = np.where(residuals.is_kind(ODOMETRY), residuals.between.max(axis=1), residuals.between[:, 0])
        return np.asarray(measured & (latest >= oldest))

    def names(self, residuals: Residuals, index: int) -> tuple[str, str]:
        """Return the names of both variables of a factor between keyframes and landmarks."""
        first, second = residuals.between[index].tolist()
        match residuals.kind[index]:
            case "wall":
                return f"x{first}", f"L{self.kept_wall(second)}"
            case "corner":
                return f"x{first}", f"C{second}"
        return f"x{first}", f"x{second}"

    def ends(self, residuals: Residuals) -> Floats:
        """Return the positions (n, 2, 2) of both variables of each factor; NaN if one is unknown or missing."""
        ends = np.full((len(residuals), 2, 2), np.nan)
        landmarks = {ODOMETRY: self._keyframes, WALL: self._walls, CORNER: self._corners}
        for kind, table in landmarks.items():
            chosen = residuals.is_kind(kind)
            first, second = residuals.between[chosen].T
            if kind == WALL:
                second = np.array([self.kept_wall(wall) for wall in second.tolist()], dtype=np.int64)
            ends[chosen, 0], ends[chosen, 1] = _rows_or_nan(self._keyframes, first), _rows_or_nan(table, second)
        return ends


def _by_identity(identity: Integers, position: Floats) -> Floats:
    """Return a table (largest identity + 1, 2) of positions by identity, NaN in empty rows."""
    table = np.full((int(identity.max(initial=-1)) + 1, 2), np.nan)
    table[identity] = position
    return table


def _rows_or_nan(table: Floats, rows: Integers) -> Floats:
    found = np.full((len(rows), 2), np.nan)
    inside = rows < len(table)
    found[inside] = table[rows[inside], :2]
    return found


def _mean_per_dof(residuals: Residuals, chosen: NDArray[np.bool_]) -> float:
    dof = int(residuals.dof[chosen].sum())
    return float(residuals.squared[chosen].sum()) / dof if dof else float("nan")
