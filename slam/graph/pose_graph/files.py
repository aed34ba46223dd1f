"""Read pose graphs in the formats of g2o and TORO, and write them in that of g2o.

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

One reader handles both, by the tags. Unknown tags that would change the optimum (other EDGE, VERTEX and PARAMS tags)
are an error; unknown tags that cannot change it (e.g. stored scans) are skipped, with one notice per tag. Vertices may
be missing: they are initialised along the edges.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from drivers.immutable import immutable

from ...errors import PoseGraphError
from ...geometry.segments import Floats, Integers
from .model import Edges, PoseGraph
from .spanning_tree import place_along_edges

# Number of components of a vertex: three of a pose, two of a landmark. Origin: definition.
VERTEX_TAGS = {"VERTEX_SE2": 3, "VERTEX2": 3, "VERTEX_XY": 2}
# Number of components of a measurement: three of a pose, two or one of a landmark. Origin: definition.
EDGE_TAGS = {"EDGE_SE2": 3, "EDGE2": 3, "EDGE_SE2_XY": 2, "EDGE_BEARING_SE2_XY": 1}
# Kind of vertex that an edge measures, by the number of components. Origin: definition.
G2O_TARGETS = {3: "pose", 2: "landmark", 1: "landmark"}
# Tag of an edge by the number of components. Origin: definition.
G2O_EDGES = {3: "EDGE_SE2", 2: "EDGE_SE2_XY", 1: "EDGE_BEARING_SE2_XY"}
# Prefixes of tags that change the optimum.
ESSENTIAL_PREFIXES = ("EDGE", "VERTEX", "PARAMS", "FIX")
# Index in the upper triangle, row by row, of each number of TORO's information matrix. Origin: definition.
TORO_ORDER = (0, 1, 3, 5, 2, 4)
# Negative eigenvalues down to minus this share of the largest are accepted as rounding in the file's text.
# Origin: numerical.
MAX_NEGATIVE_SHARE = 1e-6
# Ids that fit an int64. Origin: definition.
IDS = range(-(2**63), 2**63)
# Maximum number of characters of an invalid word that are quoted in an error. Origin: chosen, one line; not measured.
MAX_QUOTED = 40


@immutable
class PoseGraphFile:
    """A graph read from a file.

    has_vertices  False if the file has edges only; the vertices are initialised along them then
    notices       messages about skipped lines
    """

    graph: PoseGraph
    has_vertices: bool
    notices: list[str]


def read_pose_graph(path: Path) -> PoseGraphFile:
    """Read a graph in the format of g2o or TORO. Raises PoseGraphError, which names the file and the line."""
    reader = _Reader(path)
    try:
        with path.open(encoding="utf-8") as file:
            for number, line in enumerate(file, start=1):
                reader.add_line(number, line.split())
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
    """State of reading one file."""

    path: Path
    vertices: dict[int, list[float]] = field(default_factory=dict)
    edges: dict[int, list[_Edge]] = field(default_factory=lambda: {3: [], 2: [], 1: []})
    fixed: dict[int, int] = field(default_factory=dict)
    """Line that fixes each fixed vertex, by vertex id."""
    skipped: dict[str, list[int]] = field(default_factory=dict)

    def add_line(self, line: int, words: list[str]) -> None:
        """Parse the words of one line."""
        if not words or words[0].startswith("#"):
            return
        tag = words.pop(0)
        if tag in VERTEX_TAGS:
            self._add_vertex(line, tag, words)
        elif tag in EDGE_TAGS:
            self._add_edge(line, tag, words)
        elif tag == "FIX":
            self.fixed |= {self._vertex_id(line, word): line for word in words}
        elif tag.startswith(ESSENTIAL_PREFIXES):
            raise self._error(line, f"{tag[:MAX_QUOTED]} is not supported in a 2-D graph of poses and landmarks")
        else:
            self.skipped.setdefault(tag, []).append(line)

    def _add_vertex(self, line: int, tag: str, words: list[str]) -> None:
        self._count(line, tag, words, 1 + VERTEX_TAGS[tag])
        vertex_id = self._vertex_id(line, words[0])
        if vertex_id in self.vertices:
            raise self._error(line, f"vertex {vertex_id} is defined twice")
        self.vertices[vertex_id] = self._numbers(line, words[1:])

    def _add_edge(self, line: int, tag: str, words: list[str]) -> None:
        size = EDGE_TAGS[tag]
        self._count(line, tag, words, 2 + size + size * (size + 1) // 2)
        source, target = self._vertex_id(line, words[0]), self._vertex_id(line, words[1])
        if source == target:
            raise self._error(line, f"{tag} connects vertex {source} with itself")
        numbers = self._numbers(line, words[2:])
        if tag == "EDGE2":
            for index, number in zip(TORO_ORDER, numbers[size:], strict=True):
                numbers[size + index] = number
        self.edges[size].append(_Edge(source, target, numbers, line))

    def _count(self, line: int, tag: str, words: list[str], expected: int) -> None:
        if len(words) != expected:
            raise self._error(line, f"{tag} needs {expected} numbers, has {len(words)}")

    def _vertex_id(self, line: int, word: str) -> int:
        try:
            vertex_id = int(word)
        except ValueError:
            raise self._error(line, f"{word[:MAX_QUOTED]} is not a vertex id") from None
        if vertex_id not in IDS:
            raise self._error(line, f"{word[:MAX_QUOTED]} is too large for a vertex id")
        return vertex_id

    def _numbers(self, line: int, words: list[str]) -> list[float]:
        numbers = []
        for word in words:
            try:
                numbers.append(float(word))
            except ValueError:
                raise self._error(line, f"{word[:MAX_QUOTED]} is not a number") from None
        if not np.isfinite(numbers).all():
            raise self._error(line, "a number is not finite")
        return numbers

    def _error(self, line: int | None, reason: str) -> PoseGraphError:
        return PoseGraphError(self.path, line, reason)

    def finish(self) -> PoseGraphFile:
        """Build the graph after the last line."""
        if not any(self.edges.values()):
            raise self._error(None, "has no edges")
        has_vertices = bool(self.vertices)
        if not has_vertices:
            self._add_missing_vertices()
        poses = {vertex_id: k for k, vertex_id in enumerate(i for i, v in self.vertices.items() if len(v) == 3)}
        landmarks = {vertex_id: k for k, vertex_id in enumerate(i for i, v in self.vertices.items() if len(v) == 2)}
        for vertex_id, line in self.fixed.items():
            if vertex_id not in self.vertices:
                raise self._error(line, f"vertex {vertex_id}, which is to be fixed, does not exist")
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
            f"{self.path}:{lines[0]}: {tag[:MAX_QUOTED]} is skipped ({len(lines)} line{'s' * (len(lines) > 1)})"
            for tag, lines in self.skipped.items()
        ]
        return PoseGraphFile(graph if has_vertices else place_along_edges(graph), has_vertices, notices)

    def _add_missing_vertices(self) -> None:
        """Add the vertices that the edges need, ordered by their ids, for a file that has none."""
        ends = {edge.source: 3 for edges in self.edges.values() for edge in edges}
        ends |= {edge.target: 3 for edge in self.edges[3]}
        ends = {edge.target: 2 for size in (1, 2) for edge in self.edges[size]} | ends
        self.vertices = {vertex_id: [0.0] * ends[vertex_id] for vertex_id in sorted(ends)}

    def _edges(self, size: int, sources: dict[int, int], targets: dict[int, int]) -> Edges:
        edges = self.edges[size]
        for edge in edges:
            for end, vertices, kind in ((edge.source, sources, "pose"), (edge.target, targets, G2O_TARGETS[size])):
                if end not in vertices:
                    problem = f"vertex {end} is not a {kind}" if end in self.vertices else f"there is no vertex {end}"
                    raise self._error(edge.line, f"{problem}, but {G2O_EDGES[size]} needs one")
        numbers = np.array([edge.numbers for edge in edges], dtype=np.float64).reshape(
            -1, size + size * (size + 1) // 2
        )
        information = _symmetric(numbers[:, size:], size)
        eigenvalues = np.linalg.eigvalsh(information)
        indefinite = np.flatnonzero(eigenvalues[:, 0] < -MAX_NEGATIVE_SHARE * np.abs(eigenvalues).max(axis=1))
        if len(indefinite):
            raise self._error(edges[indefinite[0]].line, "the information matrix is not positive semidefinite")
        return Edges(
            source=np.array([sources[edge.source] for edge in edges], dtype=np.int64),
            target=np.array([targets[edge.target] for edge in edges], dtype=np.int64),
            measured=numbers[:, :size],
            information=information,
            line=np.array([edge.line for edge in edges], dtype=np.int64),
        )


def _symmetric(triangle: Floats, size: int) -> Floats:
    """Return symmetric matrices (k, size, size) from their upper triangles, row by row."""
    rows, columns = np.triu_indices(size)
    matrix = np.zeros((len(triangle), size, size))
    matrix[:, rows, columns] = matrix[:, columns, rows] = triangle
    return matrix


def write_g2o(path: Path, graph: PoseGraph) -> None:
    """Write a graph in g2o's format; reading it returns the same numbers to the last bit. Raises OSError."""
    fixed = [*graph.pose_ids[graph.fixed_poses].tolist(), *graph.landmark_ids[graph.fixed_landmarks].tolist()]
    lines = _vertex_lines("VERTEX_SE2", graph.pose_ids, graph.poses)
    lines += _vertex_lines("VERTEX_XY", graph.landmark_ids, graph.landmarks)
    lines += [f"FIX {vertex_id}\n" for vertex_id in fixed]
    for edges, (size, tag) in zip(graph.edges_by_kind, G2O_EDGES.items(), strict=True):
        targets = graph.pose_ids if size == 3 else graph.landmark_ids
        rows, columns = np.triu_indices(size)
        lines += _edge_lines(tag, edges, graph.pose_ids, targets, edges.information[:, rows, columns])
    path.write_text("".join(lines), encoding="utf-8", newline="\n")


def _vertex_lines(tag: str, ids: Integers, values: Floats) -> list[str]:
    return [
        f"{tag} {vertex_id} {' '.join(map(repr, value))}\n"
        for vertex_id, value in zip(ids.tolist(), values.tolist(), strict=True)
    ]


def _edge_lines(tag: str, edges: Edges, sources: Integers, targets: Integers, triangle: Floats) -> list[str]:
    numbers = np.hstack([edges.measured, triangle]).tolist()
    ends = zip(sources[edges.source].tolist(), targets[edges.target].tolist(), strict=True)
    return [
        f"{tag} {source} {target} {' '.join(map(repr, row))}\n"
        for (source, target), row in zip(ends, numbers, strict=True)
    ]
