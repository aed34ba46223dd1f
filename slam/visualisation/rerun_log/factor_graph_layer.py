"""Draw factors and their residuals: in the map, as the graph of one keyframe, as a histogram, and as a table."""

from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from drivers import se2

from ...events import GraphInspected, KeyframeAdded
from ...geometry.chi_square import chi_square_tail
from ...geometry.segments import Floats, Integers
from ...graph.residuals import CORNER, GAUGE_PRIOR, MEASUREMENTS, ODOMETRY, WALL, Residuals
from ...mapping.map_features import MapCorners, MapWalls
from . import colours
from .colours import Colour
from .documents import residual_report
from .feature_matches import FeatureMatches
from .rrd_writer import RrdWriter
from .shapes import Height, segment_ends, to_3d
from .time_series import TimeSeries

OUTLIER_GATE = 10.8
"""Squared Mahalanobis distance per degree of freedom beyond which a factor is drawn as an outlier: chi-square, 1 dof,
99.9 %."""
WORST_FACTORS = 12  # factors listed by name and drawn
BIN, BINS = 0.25, 16  # width and number of the histogram's bins, sigmas; the last one has all beyond
GRAPH_SCALE = 60.0  # points per metre in the graph view, whose y axis points down

_NODE_COLOURS = {"x": colours.ESTIMATE, "L": colours.WALL, "C": colours.CORNER}
_THIN, _THICK = rr.Radius.ui_points(0.7), rr.Radius.ui_points(1.6)


class FactorGraphLayer:
    """Inspections of the factor graph, drawn over the map as last received."""

    def __init__(self, writer: RrdWriter, time_series: TimeSeries) -> None:
        self._writer, self._time_series = writer, time_series
        self._merged: list[tuple[int, int, int, bool]] = []  # keyframe, absorbed, kept, merged by a loop closure
        outliers = rr.LineStrips3D.from_fields(radii=_THICK, colors=colours.CONTRADICTION, show_labels=True)
        writer.log_static("world/factors/outliers", outliers)
        writer.log_static("world/factors/keyframe", rr.LineStrips3D.from_fields(radii=_THIN, show_labels=False))

    def merge(self, keyframe: int, absorbed: int, kept: int, *, loop: bool) -> None:
        """Record that two walls were merged at a keyframe."""
        self._merged.append((keyframe, absorbed, kept, loop))

    def unmerge(self, keyframe: int) -> None:
        """Undo the merges from a keyframe on."""
        self._merged = [merged for merged in self._merged if merged[0] < keyframe]

    def log(self, event: GraphInspected, keyframes: Floats, walls: MapWalls, corners: MapCorners) -> None:
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
        present = [kind for kind in MEASUREMENTS if kind in residuals.kind]
        fits |= {kind: _mean_per_dof(residuals, residuals.is_kind(kind)) for kind in present}
        self._time_series.log("fit", fits)
        merged_into = {absorbed: kept for _, absorbed, kept, _ in self._merged}
        positions = _VariablePositions(keyframes, walls, corners, merged_into)
        self._log_in_map(residuals, worst, positions)
        self._log_histogram(residuals)

    def log_keyframe(self, event: KeyframeAdded, previous: se2.Pose | None) -> None:
        """Draw the factors of a keyframe, as lines in the map and as a graph: to landmarks and to the previous pose."""
        walls, corners = FeatureMatches.of_segments(event), FeatureMatches.of_corners(event)
        centres = segment_ends(event.segments, event.pose).mean(axis=1).reshape(-1, 2)
        spots = se2.transform(event.pose, event.corners.position.reshape(-1, 2))
        here = f"x{event.index}"
        drawn: list[tuple[str, str, Floats, Colour]] = []  # variable, label, position, colour
        if previous is not None:
            drawn.append((f"x{event.index - 1}", f"x{event.index - 1} - {here}", previous[:2], colours.ESTIMATE))
        for matches, positions in ((walls, centres), (corners, spots)):
            rows = zip(matches.landmark_id.tolist(), matches.labels(), positions, matches.new.tolist(), strict=True)
            for landmark, label, position, new in rows:
                if landmark >= 0:
                    shade = colours.NEW if new else colours.MATCHED
                    drawn.append((f"{matches.prefix}{landmark}", f"{here} - {label}", position, shade))
        ends = np.array([[event.pose[:2], position] for _, _, position, _ in drawn]).reshape(-1, 2, 2)
        self._writer.log_batched(
            "world/factors/keyframe",
            rr.LineStrips3D,
            strips=to_3d(ends, Height.LINK),
            colors=[shade for *_, shade in drawn],
            labels=[label for _, label, *_ in drawn],
        )
        self._log_graph(here, event.pose[:2], {name: position for name, _, position, _ in drawn})

    def _log_graph(self, here: str, centre: Floats, neighbours: dict[str, Floats]) -> None:
        """Draw a keyframe and the variables that it shares factors with as nodes around it."""
        merged_by_loop = {f"L{kept}" for *_, kept, loop in self._merged if loop}
        nodes = {here: centre} | neighbours
        shades = [colours.CLOSURE if name in merged_by_loop else _NODE_COLOURS[name[0]] for name in nodes]
        self._writer.log_batched(
            "graph",
            rr.GraphNodes,
            node_ids=list(nodes),
            positions=(np.array(list(nodes.values())) - centre) * [GRAPH_SCALE, -GRAPH_SCALE],
            colors=shades,
            labels=list(nodes),
            radii=[4.0] * len(nodes),
        )
        edges = np.array([(here, name) for name in neighbours], dtype=np.str_).reshape(-1, 2)
        self._writer.log_batched("graph", rr.GraphEdges, edges=edges, graph_type=["undirected"])

    def _log_histogram(self, residuals: Residuals) -> None:
        """Log how many observations of walls deviate by how many sigmas, and how many would if noise is as modelled.

        The covariances of the other kinds are widened, as they share points or errors with walls.
        """
        deviations = np.sqrt(residuals.squared[residuals.is_kind(WALL)])
        limits = BIN * np.arange(BINS + 1)
        limits[-1] = np.inf
        observed, _ = np.histogram(deviations, limits)
        tails = chi_square_tail(1, np.asarray(limits**2 / residuals.expected_wall_variance(), dtype=np.float64))
        expected = -len(deviations) * np.diff(tails)
        middles, total = BIN * (np.arange(BINS) + 0.5), max(len(deviations), 1)
        for place, (name, counts, shade) in enumerate(
            (("observed", observed, colours.ESTIMATE), ("expected", expected, colours.ODOMETRY))
        ):
            bars = rr.BarChart(
                100.0 * counts / total,
                color=shade,
                abscissa=middles + BIN * (0.5 * place - 0.25),
                widths=np.full(BINS, 0.45 * BIN),
            )
            self._writer.log(f"residuals/histogram/{name}", bars)

    def _log_in_map(self, residuals: Residuals, worst: NDArray[np.int64], positions: _VariablePositions) -> None:
        """Draw and label those of the worst factors that are outliers. All misfitting factors would cover the map."""
        ends = positions.ends(residuals)[worst]
        drawn = np.isfinite(ends).all(axis=(1, 2)) & (residuals.squared[worst] > OUTLIER_GATE * residuals.dof[worst])
        labels = [f"{residuals.name(k)} d²={residuals.squared[k]:.0f}" for k in worst[drawn].tolist()]
        outliers = rr.LineStrips3D.from_fields(strips=to_3d(ends[drawn], Height.LINK), labels=labels)
        self._writer.log("world/factors/outliers", outliers)


class _VariablePositions:
    """Positions of the graph's variables in the map; a merged wall has the position of the wall it was merged into."""

    def __init__(self, keyframes: Floats, walls: MapWalls, corners: MapCorners, merged_into: dict[int, int]) -> None:
        self._keyframes, self._merged_into = keyframes, merged_into
        middles = walls.end_points().mean(axis=1).reshape(-1, 2)
        self._walls = _by_identity(walls.identity, middles)
        self._corners = _by_identity(corners.identity, corners.position.reshape(-1, 2))

    def kept_wall(self, wall: int) -> int:
        """Return the id of the wall that this one was merged into, else its own."""
        while wall in self._merged_into:
            wall = self._merged_into[wall]
        return wall

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
