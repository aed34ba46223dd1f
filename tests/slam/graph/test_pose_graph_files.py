"""Files of pose graphs: round trips, and errors that name the line."""

from __future__ import annotations

import tempfile
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slam.errors import PoseGraphError
from slam.graph.pose_graph import Edges, PoseGraph, read_pose_graph, write_g2o

finite = st.floats(-1e6, 1e6)


def random_matrices(generator: np.random.Generator, count: int, size: int) -> np.ndarray:
    root = generator.normal(size=(count, size, size)) * generator.choice([1e-3, 1.0, 1e3], (count, 1, 1))
    product = root @ root.transpose(0, 2, 1)
    return (product + product.transpose(0, 2, 1)) / 2


@st.composite
def graphs(draw: st.DrawFn) -> PoseGraph:
    generator = np.random.default_rng(draw(st.integers(0, 2**32)))
    n, m = draw(st.integers(2, 6)), draw(st.integers(0, 4))
    ids = np.array(draw(st.lists(st.integers(-(2**40), 2**40), min_size=n + m, max_size=n + m, unique=True)), np.int64)
    x = draw(finite)

    def edges(size: int, targets: int) -> Edges:
        k = draw(st.integers(1, 5)) if targets else 0
        source = generator.integers(0, n, k)
        target = (source + generator.integers(1, n, k)) % n if size == 3 else generator.integers(0, max(targets, 1), k)
        return Edges(
            source, target, generator.normal(x, 10, (k, size)), random_matrices(generator, k, size), np.zeros(k, int)
        )

    return PoseGraph(
        pose_ids=ids[:n],
        poses=generator.normal(x, 10, (n, 3)),
        landmark_ids=ids[n:],
        landmarks=generator.normal(x, 10, (m, 2)),
        motions=edges(3, n),
        positions=edges(2, m),
        bearings=edges(1, m),
        fixed_poses=generator.random(n) < 0.3,
        fixed_landmarks=generator.random(m) < 0.3,
    )


def assert_same(one: PoseGraph, other: PoseGraph) -> None:
    for name in ("pose_ids", "poses", "landmark_ids", "landmarks", "fixed_poses", "fixed_landmarks"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for mine, theirs in zip(one.edges_by_kind, other.edges_by_kind, strict=True):
        for name in ("source", "target", "measured", "information"):
            np.testing.assert_array_equal(getattr(mine, name), getattr(theirs, name))


@settings(max_examples=60, deadline=None)
@given(graphs())
def test_g2o_round_trip(graph: PoseGraph) -> None:
    with tempfile.TemporaryDirectory() as folder:
        write_g2o(Path(folder) / "a.g2o", graph)
        assert_same(read_pose_graph(Path(folder) / "a.g2o").graph, graph)


VERTICES = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nVERTEX_XY 2 1 1\n"
EDGE = "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n"


def read(tmp_path: Path, text: str | bytes) -> PoseGraph:
    (tmp_path / "a.g2o").write_bytes(text.encode() if isinstance(text, str) else text)
    return read_pose_graph(tmp_path / "a.g2o").graph


def test_toro_order_of_the_information_matrix(tmp_path: Path) -> None:
    graph = read(tmp_path, "EDGE2 0 1 1 0 0 10 1 20 30 2 3\n")
    assert graph.motions.information[0].tolist() == [[10, 1, 2], [1, 20, 3], [2, 3, 30]]


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("VERTEX_SE2 5 1 2", "VERTEX_SE2 needs 4 numbers, has 3"),
        ("VERTEX_SE2 1 0 0 0", "vertex 1 is defined twice"),
        ("VERTEX_XY 5 1 two", "two is not a number"),
        ("VERTEX_XY 5.5 1 2", "5.5 is not a vertex id"),
        (f"VERTEX_XY {2**63} 1 2", "too large"),
        ("VERTEX_XY 5 1 nan", "not finite"),
        ("EDGE_SE2 0 1 1 0 0 1 0 0 1 0", "EDGE_SE2 needs 11 numbers, has 10"),
        ("EDGE_SE2 0 0 1 0 0 1 0 0 1 0 1", "connects vertex 0 with itself"),
        ("EDGE_SE2 0 7 1 0 0 1 0 0 1 0 1", "there is no vertex 7"),
        ("EDGE_SE2 0 2 1 0 0 1 0 0 1 0 1", "vertex 2 is not a pose"),
        ("EDGE_SE2_XY 0 1 1 0 1 0 1", "vertex 1 is not a landmark"),
        ("EDGE_SE2_XY 2 0 1 0 1 0 1", "vertex 2 is not a pose"),
        ("EDGE_BEARING_SE2_XY 0 2 1 -1", "not positive semidefinite"),
        ("EDGE_SE2 0 1 1 0 0 1 2 0 1 0 1", "not positive semidefinite"),
        ("EDGE_SE3:QUAT 0 1 0 0 0 0 0 0 1", "EDGE_SE3:QUAT is not supported in a 2-D graph"),
        ("EDGE_PRIOR_SE2 0 1 1 0 0 1 0 0 1 0 1", "EDGE_PRIOR_SE2 is not supported"),
        ("FIX 9", "vertex 9, which is to be fixed, does not exist"),
    ],
)
def test_errors_name_the_line(tmp_path: Path, line: str, reason: str) -> None:
    with pytest.raises(PoseGraphError) as caught:
        read(tmp_path, VERTICES + EDGE + line + "\n" + EDGE)
    assert (caught.value.path, caught.value.line) == (tmp_path / "a.g2o", 5)
    assert str(caught.value).startswith(f"{tmp_path / 'a.g2o'}:5: ")
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "reason"), [("", "no edges"), (VERTICES, "no edges"), (b"\xff\xfe\x00", "not a text")]
)
def test_files_without_a_graph_are_refused(tmp_path: Path, text: str | bytes, reason: str) -> None:
    with pytest.raises(PoseGraphError, match=reason):
        read(tmp_path, text)


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_damaged_files_are_refused_or_read_but_never_crash(data: st.DataObject) -> None:
    text = bytearray(
        (VERTICES + "FIX 0\n" + EDGE + "EDGE_SE2_XY 0 2 1 1 1 0 1\nEDGE_BEARING_SE2_XY 1 2 1 1\n").encode()
    )
    for _ in range(data.draw(st.integers(1, 4))):
        text[data.draw(st.integers(0, len(text) - 1))] = data.draw(st.sampled_from(b" \n-.019eEXnF#\xff"))
    with tempfile.TemporaryDirectory() as folder, suppress(PoseGraphError):
        graph = read(Path(folder), bytes(text))
        assert graph.edge_count >= 1
        assert np.isfinite(graph.poses).all()


def test_skipped_tags_are_reported_once(tmp_path: Path) -> None:
    (tmp_path / "a.g2o").write_text("# made by hand\n\n" + VERTICES + EDGE + "ROBOTLASER1 0 1\n" * 3)
    file = read_pose_graph(tmp_path / "a.g2o")
    assert file.notices == [f"{tmp_path / 'a.g2o'}:7: ROBOTLASER1 is skipped (3 lines)"]
    assert file.graph.motions.line.tolist() == [6]


def test_missing_vertices_are_initialised_along_the_edges(tmp_path: Path) -> None:
    information = "1 0 0 1 0 1\n"
    text = f"EDGE_SE2 3 5 2 0 1.5707963267948966 {information}EDGE_SE2 9 5 -1 0 0 {information}"
    text += "EDGE_SE2_XY 5 4 1 1 1 0 1\nEDGE_BEARING_SE2_XY 3 6 0.7853981633974483 1\n"
    text += "EDGE_BEARING_SE2_XY 5 6 0 1\n"
    graph = read(tmp_path, text)
    assert graph.pose_ids.tolist() == [3, 5, 9]
    np.testing.assert_allclose(graph.poses[:, :2], [[0, 0], [2, 0], [2, 1]], atol=1e-12)
    assert graph.landmark_ids.tolist() == [4, 6]
    np.testing.assert_allclose(graph.landmarks, [[1, 1], [2, 2]], atol=1e-3)
