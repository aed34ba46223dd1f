"""The factor graph and how well its factors fit: in the map, as a graph of its own, and in words."""

from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from ...events import GraphInspected, MapCorners, MapWalls
from ...geometry.segments import Floats, Integers
from ...graph.factor_residuals import ALONG, CORNER, ODOMETRY, SAME_WALL, WALL, Residuals
from . import colours
from .colours import Colour
from .documents import residual_report
from .metrics import Metrics
from .recording import Recording
from .shapes import Layer, lift

DOUBTFUL = 10.8
"""Squared Mahalanobis distance per number measured beyond which a factor is drawn as not fitting: chi-square with one
degree of freedom at 99.9 %."""
NOTABLE = 4.0  # from here on it is drawn
WORST = 12  # factors that are named
LATEST = 40  # keyframes in the graph's own view: a person cannot follow more, nor can the viewer lay them out
SCALE = 60.0  # points a metre in the graph's own view, whose y points down

_NODES = {"x": colours.ESTIMATE, "L": colours.WALL, "C": colours.CORNER}
_THIN, _THICK = rr.Radius.ui_points(0.4), rr.Radius.ui_points(1.6)


class InspectionLayer:
    """Logs inspections, with the map as it was last heard of."""

    def __init__(self, recording: Recording, metrics: Metrics) -> None:
        self._recording, self._metrics = recording, metrics
        self._merged: list[tuple[int, int, int, bool]] = []  # keyframe, absorbed, kept, whether a loop was closed
        recording.keep("world/factors/notable", rr.LineStrips3D.from_fields(radii=_THIN, colors=colours.ODOMETRY))
        doubtful = rr.LineStrips3D.from_fields(radii=_THICK, colors=colours.REFUSED, show_labels=True)
        recording.keep("world/factors/doubtful", doubtful)

    def merge(self, keyframe: int, absorbed: int, kept: int, *, loop: bool) -> None:
        """Two walls are one since a keyframe."""
        self._merged.append((keyframe, absorbed, kept, loop))

    def unmerge(self, keyframe: int) -> None:
        """What has been merged since a keyframe is not."""
        self._merged = [merged for merged in self._merged if merged[0] < keyframe]

    def log(self, event: GraphInspected, keyframes: Floats, lines: MapWalls, corners: MapCorners) -> None:
        """Log the graph over keyframes (k, 3) and landmarks."""
        residuals = event.residuals
        if not len(residuals):
            return
        self._recording.log(
            "residuals/report", rr.TextDocument(residual_report(residuals, WORST), media_type=rr.MediaType.MARKDOWN)
        )
        worst = residuals.worst(WORST)
        if not len(worst):
            return
        row = rr.AnyValues(
            factor=[residuals.name(place) for place in worst.tolist()],
            kind=[residuals.kind[place] for place in worst.tolist()],
            squared=residuals.squared[worst],
            freedom=residuals.freedom[worst],
        )
        self._recording.log("residuals/worst", row)
        measured = ~residuals.of(ALONG)
        fits = {"all": _mean(residuals, measured)}
        fits |= {kind: _mean(residuals, residuals.of(kind)) for kind in (ODOMETRY, WALL, CORNER, SAME_WALL)}
        self._metrics.log("fit", fits)
        kept = {absorbed: into for _, absorbed, into, _ in self._merged}
        places = _Places(keyframes, lines, corners, kept)
        self._log_in_map(residuals, places)
        self._log_latest(residuals, places)

    def _log_in_map(self, residuals: Residuals, places: _Places) -> None:
        """The factors that fit badly as lines between keyframes and landmarks; those that do not fit are labelled.

        All of them would be a grey sheet.
        """
        ends, misfit = places.ends(residuals), residuals.squared / residuals.freedom
        known = np.isfinite(ends).all(axis=(1, 2)) & (misfit > NOTABLE)
        doubtful = known & (misfit > DOUBTFUL)
        notable = rr.LineStrips3D.from_fields(strips=lift(ends[known & ~doubtful], Layer.ODOMETRY))
        self._recording.log("world/factors/notable", notable)
        labels = [f"{residuals.name(k)} d²={residuals.squared[k]:.0f}" for k in np.flatnonzero(doubtful).tolist()]
        bad = rr.LineStrips3D.from_fields(strips=lift(ends[doubtful], Layer.LINK), labels=labels)
        self._recording.log("world/factors/doubtful", bad)

    def _log_latest(self, residuals: Residuals, places: _Places) -> None:
        """The part of the graph that the last keyframes are in, as nodes and edges."""
        recent = places.recent(residuals, LATEST)
        ends, closing = places.ends(residuals), {places.kept(kept) for *_, kept, loop in self._merged if loop}
        nodes: dict[str, tuple[Floats, Colour]] = {}
        edges = []
        for place in np.flatnonzero(recent & np.isfinite(ends).all(axis=(1, 2))).tolist():
            both = places.names(residuals, place)
            edges.append(both)
            for name, position in zip(both, ends[place], strict=True):
                shade = _NODES[name[0]]
                if name[0] == "L" and int(name[1:]) in closing:
                    shade = colours.CLOSURE
                nodes[name] = position * [SCALE, -SCALE], shade
        names = list(nodes)
        drawn = rr.GraphNodes(
            names,
            positions=[position for position, _ in nodes.values()],
            colors=[shade for _, shade in nodes.values()],
            labels=names,
            radii=[4.0] * len(names),
        )
        self._recording.log("graph", drawn)
        self._recording.log("graph", rr.GraphEdges(edges, graph_type="undirected"))


class _Places:
    """Where the variables are in the map; of walls that are one, where the one is that is kept."""

    def __init__(self, keyframes: Floats, lines: MapWalls, corners: MapCorners, kept: dict[int, int]) -> None:
        self._keyframes, self._kept = keyframes, kept
        middles = lines.end_points().mean(axis=1).reshape(-1, 2)
        self._walls = _by_identity(lines.identity, middles)
        self._corners = _by_identity(corners.identity, corners.position.reshape(-1, 2))

    def kept(self, wall: int) -> int:
        """The wall that speaks for this one."""
        while wall in self._kept:
            wall = self._kept[wall]
        return wall

    def recent(self, residuals: Residuals, count: int) -> NDArray[np.bool_]:
        """(n,) which factors are of the last `count` keyframes, and measure something between two variables."""
        oldest = len(self._keyframes) - count
        measured = residuals.of(ODOMETRY) | residuals.of(WALL) | residuals.of(CORNER)
        latest = np.where(residuals.of(ODOMETRY), residuals.between.max(axis=1), residuals.between[:, 0])
        return np.asarray(measured & (latest >= oldest))

    def names(self, residuals: Residuals, place: int) -> tuple[str, str]:
        """Of the two variables of a factor between keyframes and landmarks."""
        first, second = residuals.between[place].tolist()
        match residuals.kind[place]:
            case "wall":
                return f"x{first}", f"L{self.kept(second)}"
            case "corner":
                return f"x{first}", f"C{second}"
        return f"x{first}", f"x{second}"

    def ends(self, residuals: Residuals) -> Floats:
        """(n, 2, 2): both ends of each factor, NaN where one is not known or there is only one."""
        ends = np.full((len(residuals), 2, 2), np.nan)
        landmarks = {ODOMETRY: self._keyframes, WALL: self._walls, CORNER: self._corners}
        for kind, table in landmarks.items():
            chosen = residuals.of(kind)
            first, second = residuals.between[chosen].T
            if kind == WALL:
                second = np.array([self.kept(wall) for wall in second.tolist()], dtype=np.int64)
            ends[chosen, 0], ends[chosen, 1] = _looked_up(self._keyframes, first), _looked_up(table, second)
        return ends


def _by_identity(identity: Integers, position: Floats) -> Floats:
    """(largest identity + 1, 2): positions by identity, NaN where there is none."""
    table = np.full((int(identity.max(initial=-1)) + 1, 2), np.nan)
    table[identity] = position
    return table


def _looked_up(table: Floats, rows: Integers) -> Floats:
    found = np.full((len(rows), 2), np.nan)
    inside = rows < len(table)
    found[inside] = table[rows[inside], :2]
    return found


def _mean(residuals: Residuals, chosen: NDArray[np.bool_]) -> float:
    freedom = int(residuals.freedom[chosen].sum())
    return float(residuals.squared[chosen].sum()) / freedom if freedom else float("nan")
