"""Pose graphs on disk, in the formats of g2o and TORO.

g2o                                             information matrix, row by row of its upper triangle
    VERTEX_SE2 id x y heading
    VERTEX_XY id x y
    FIX id ...
    EDGE_SE2 from to x y heading  I              xx xy xh yy yh hh
    EDGE_SE2_XY from to x y  I                   xx xy yy
    EDGE_BEARING_SE2_XY from to bearing  I       bb

TORO
    VERTEX2 id x y heading
    EDGE2 from to x y heading  I                 xx xy yy hh xh yh

One reader takes both, by the tags. What would change the optimum and is not known (other EDGE, VERTEX and PARAMS tags)
is refused; what cannot change it (scans that were stored along, for example) is left out, with a notice for each such
tag. A file without vertices is complete: they are placed along its edges.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...errors import PoseGraphError
from .model import Edges, Floats, Integers, PoseGraph
from .placing import place_along_edges

VERTEX_TAGS = {"VERTEX_SE2": 3, "VERTEX2": 3, "VERTEX_XY": 2}
"""How many numbers a vertex has: three make a pose, two a landmark."""
EDGE_TAGS = {"EDGE_SE2": 3, "EDGE2": 3, "EDGE_SE2_XY": 2, "EDGE_BEARING_SE2_XY": 1}
"""How many numbers are measured: three of a pose, two or one of a landmark."""
G2O_TARGETS = {3: "pose", 2: "landmark", 1: "landmark"}
G2O_EDGES = {3: "EDGE_SE2", 2: "EDGE_SE2_XY", 1: "EDGE_BEARING_SE2_XY"}
ESSENTIAL = ("EDGE", "VERTEX", "PARAMS", "FIX")
"""Beginnings of tags that say what is to be optimised."""
TORO_ORDER = (0, 1, 3, 5, 2, 4)
"""Where the numbers of TORO's information matrix stand in the upper triangle, row by row."""
INDEFINITE = 1e-6
"""An eigenvalue below minus this share of the largest is more than rounding in the file's text."""
IDS = range(-(2**63), 2**63)
SHOWN = 40
"""Characters of a bad word that are worth repeating."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseGraphFile:
    """What a file holds; whether it says where its vertices are; and what of it was left out, for a person to read."""

    graph: PoseGraph
    placed: bool
    notices: list[str]


def read_pose_graph(path: Path) -> PoseGraphFile:
    """Read a graph in g2o's or TORO's format. Raises PoseGraphError, which names the file and the line."""
    reader = _Reader(path)
    try:
        with path.open(encoding="utf-8") as file:
            for number, line in enumerate(file, start=1):
                reader.take(number, line.split())
    except OSError as error:
        raise PoseGraphError(path, None, error.strerror or str(error)) from error
    except UnicodeDecodeError as error:
        raise PoseGraphError(path, None, "is not a text file") from error
    return reader.finish()


@dataclass(frozen=True, slots=True)
class _Edge:
    source: int
    target: int
    numbers: list[float]
    line: int


@dataclass(slots=True)
class _Reader:
    """What has been read of a file so far."""

    path: Path
    vertices: dict[int, list[float]] = field(default_factory=dict)
    edges: dict[int, list[_Edge]] = field(default_factory=lambda: {3: [], 2: [], 1: []})
    fixed: dict[int, int] = field(default_factory=dict)
    """Ids of vertices and the line that fixes each."""
    skipped: dict[str, list[int]] = field(default_factory=dict)

    def take(self, line: int, words: list[str]) -> None:
        """Take the words of one line."""
        if not words or words[0].startswith("#"):
            return
        tag = words.pop(0)
        if tag in VERTEX_TAGS:
            self._take_vertex(line, tag, words)
        elif tag in EDGE_TAGS:
            self._take_edge(line, tag, words)
        elif tag == "FIX":
            self.fixed |= {self._identity(line, word): line for word in words}
        elif tag.startswith(ESSENTIAL):
            raise self._wrong(line, f"{tag[:SHOWN]} is no part of a 2-D graph of poses and landmarks")
        else:
            self.skipped.setdefault(tag, []).append(line)

    def _take_vertex(self, line: int, tag: str, words: list[str]) -> None:
        self._count(line, tag, words, 1 + VERTEX_TAGS[tag])
        identity = self._identity(line, words[0])
        if identity in self.vertices:
            raise self._wrong(line, f"vertex {identity} is there already")
        self.vertices[identity] = self._numbers(line, words[1:])

    def _take_edge(self, line: int, tag: str, words: list[str]) -> None:
        size = EDGE_TAGS[tag]
        self._count(line, tag, words, 2 + size + size * (size + 1) // 2)
        source, target = self._identity(line, words[0]), self._identity(line, words[1])
        if source == target:
            raise self._wrong(line, f"{tag} connects vertex {source} with itself")
        numbers = self._numbers(line, words[2:])
        if tag == "EDGE2":
            for place, number in zip(TORO_ORDER, numbers[size:], strict=True):
                numbers[size + place] = number
        self.edges[size].append(_Edge(source, target, numbers, line))

    def _count(self, line: int, tag: str, words: list[str], expected: int) -> None:
        if len(words) != expected:
            raise self._wrong(line, f"{tag} is followed by {expected} numbers, not by {len(words)}")

    def _identity(self, line: int, word: str) -> int:
        try:
            identity = int(word)
        except ValueError:
            raise self._wrong(line, f"{word[:SHOWN]} is not the id of a vertex") from None
        if identity not in IDS:
            raise self._wrong(line, f"{word[:SHOWN]} is too large for the id of a vertex")
        return identity

    def _numbers(self, line: int, words: list[str]) -> list[float]:
        numbers = []
        for word in words:
            try:
                numbers.append(float(word))
            except ValueError:
                raise self._wrong(line, f"{word[:SHOWN]} is not a number") from None
        if not np.isfinite(numbers).all():
            raise self._wrong(line, "a number is not finite")
        return numbers

    def _wrong(self, line: int | None, reason: str) -> PoseGraphError:
        return PoseGraphError(self.path, line, reason)

    def finish(self) -> PoseGraphFile:
        """The graph, when all lines have been taken."""
        if not any(self.edges.values()):
            raise self._wrong(None, "has no edges")
        placed = bool(self.vertices)
        if not placed:
            self._invent_vertices()
        poses = {identity: k for k, identity in enumerate(i for i, v in self.vertices.items() if len(v) == 3)}
        landmarks = {identity: k for k, identity in enumerate(i for i, v in self.vertices.items() if len(v) == 2)}
        for identity, line in self.fixed.items():
            if identity not in self.vertices:
                raise self._wrong(line, f"there is no vertex {identity} to fix")
        graph = PoseGraph(
            pose_ids=np.array(list(poses), dtype=np.int64),
            poses=np.array([self.vertices[i] for i in poses], dtype=np.float64).reshape(-1, 3),
            landmark_ids=np.array(list(landmarks), dtype=np.int64),
            landmarks=np.array([self.vertices[i] for i in landmarks], dtype=np.float64).reshape(-1, 2),
            motions=self._edges(3, poses, poses),
            positions=self._edges(2, poses, landmarks),
            bearings=self._edges(1, poses, landmarks),
            fixed_poses=np.array([i in self.fixed for i in poses], dtype=bool),
            fixed_landmarks=np.array([i in self.fixed for i in landmarks], dtype=bool),
        )
        notices = [
            f"{self.path}:{lines[0]}: {tag[:SHOWN]} is not used ({len(lines)} such line{'s' * (len(lines) > 1)})"
            for tag, lines in self.skipped.items()
        ]
        return PoseGraphFile(graph if placed else place_along_edges(graph), placed, notices)

    def _invent_vertices(self) -> None:
        """Vertices of the kinds that the edges need, ordered by their ids, for a file that has none."""
        ends = {edge.source: 3 for edges in self.edges.values() for edge in edges}
        ends |= {edge.target: 3 for edge in self.edges[3]}
        ends = {edge.target: 2 for size in (1, 2) for edge in self.edges[size]} | ends
        self.vertices = {identity: [0.0] * ends[identity] for identity in sorted(ends)}

    def _edges(self, size: int, sources: dict[int, int], targets: dict[int, int]) -> Edges:
        edges = self.edges[size]
        for edge in edges:
            for end, known, kind in ((edge.source, sources, "pose"), (edge.target, targets, G2O_TARGETS[size])):
                if end not in known:
                    there = f"vertex {end} is no {kind}" if end in self.vertices else f"there is no vertex {end}"
                    raise self._wrong(edge.line, f"{there}, as {G2O_EDGES[size]} needs it")
        numbers = np.array([edge.numbers for edge in edges], dtype=np.float64).reshape(
            -1, size + size * (size + 1) // 2
        )
        information = _symmetric(numbers[:, size:], size)
        eigenvalues = np.linalg.eigvalsh(information)
        indefinite = np.flatnonzero(eigenvalues[:, 0] < -INDEFINITE * np.abs(eigenvalues).max(axis=1))
        if len(indefinite):
            raise self._wrong(edges[indefinite[0]].line, "the information matrix is not positive semidefinite")
        return Edges(
            source=np.array([sources[edge.source] for edge in edges], dtype=np.int64),
            target=np.array([targets[edge.target] for edge in edges], dtype=np.int64),
            measured=numbers[:, :size],
            information=information,
            line=np.array([edge.line for edge in edges], dtype=np.int64),
        )


def _symmetric(triangle: Floats, size: int) -> Floats:
    """(k, size, size) from the upper triangles, row by row."""
    rows, columns = np.triu_indices(size)
    matrix = np.zeros((len(triangle), size, size))
    matrix[:, rows, columns] = matrix[:, columns, rows] = triangle
    return matrix


def write_g2o(path: Path, graph: PoseGraph) -> None:
    """Write a graph so that reading it gives the same numbers to the last bit. Raises OSError."""
    fixed = [*graph.pose_ids[graph.fixed_poses].tolist(), *graph.landmark_ids[graph.fixed_landmarks].tolist()]
    lines = _vertex_lines("VERTEX_SE2", graph.pose_ids, graph.poses)
    lines += _vertex_lines("VERTEX_XY", graph.landmark_ids, graph.landmarks)
    lines += [f"FIX {identity}\n" for identity in fixed]
    for edges, (size, tag) in zip(graph.kinds, G2O_EDGES.items(), strict=True):
        targets = graph.pose_ids if size == 3 else graph.landmark_ids
        rows, columns = np.triu_indices(size)
        lines += _edge_lines(tag, edges, graph.pose_ids, targets, edges.information[:, rows, columns])
    path.write_text("".join(lines), encoding="utf-8", newline="\n")


def write_toro(path: Path, graph: PoseGraph) -> None:
    """Write a graph of poses in TORO's format, which knows neither landmarks nor fixed vertices.

    Raises PoseGraphError where the graph has some, OSError.
    """
    if len(graph.landmarks) or graph.fixed_poses.any():
        raise PoseGraphError(path, None, "TORO's format knows neither landmarks nor fixed vertices")
    rows, columns = np.triu_indices(3)
    triangle = graph.motions.information[:, rows, columns][:, TORO_ORDER]
    lines = _vertex_lines("VERTEX2", graph.pose_ids, graph.poses)
    lines += _edge_lines("EDGE2", graph.motions, graph.pose_ids, graph.pose_ids, triangle)
    path.write_text("".join(lines), encoding="utf-8", newline="\n")


def _vertex_lines(tag: str, ids: Integers, values: Floats) -> list[str]:
    return [
        f"{tag} {identity} {' '.join(map(repr, value))}\n"
        for identity, value in zip(ids.tolist(), values.tolist(), strict=True)
    ]


def _edge_lines(tag: str, edges: Edges, sources: Integers, targets: Integers, triangle: Floats) -> list[str]:
    numbers = np.hstack([edges.measured, triangle]).tolist()
    ends = zip(sources[edges.source].tolist(), targets[edges.target].tolist(), strict=True)
    return [
        f"{tag} {source} {target} {' '.join(map(repr, row))}\n"
        for (source, target), row in zip(ends, numbers, strict=True)
    ]
