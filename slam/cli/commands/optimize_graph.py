"""`wclm optimize` of a 2-D pose graph."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import PoseGraphError
from ..console import print_message

if TYPE_CHECKING:
    from ...graph.pose_graph import OptimisedGraph, PoseGraph, PoseGraphFile

SHOWN_REJECTED = 4
"""Number of rejected edges that are listed by name."""


def optimize_graph(path: Path, out: Path, *, overwrite: bool, robust: bool, picture: bool) -> list[str]:
    """Optimise a pose graph and write an output directory; return a summary as lines of text.

    robust   leave out edges that contradict the others
    picture  draw the graph before and after

    Raises SlamError; then nothing is left behind.
    """
    from ...graph.pose_graph import optimise, read_pose_graph, write_g2o
    from ...io.json_files import write_json
    from ...io.output_dir import GRAPH, GRAPH_PICTURE, SUMMARY, OutputDirectory

    started = time.perf_counter()
    with OutputDirectory(out, overwrite) as directory:
        file = read_pose_graph(path)
        for notice in file.notices:
            print_message(notice)
        before = time.perf_counter()
        with np.errstate(all="ignore"):  # checked below
            optimised = optimise(file.graph, robust)
        solving = time.perf_counter() - before
        if not np.isfinite([optimised.chi2, *optimised.graph.poses.flat, *optimised.graph.landmarks.flat]).all():
            raise PoseGraphError(path, None, "its numbers are so large that it has no finite optimum")
        write_g2o(directory / GRAPH, optimised.graph)
        if picture:
            from ...visualisation.plots import plot_pose_graph

            plot_pose_graph(directory / GRAPH_PICTURE, file.graph, optimised, title=path.name)
        summary = _summarise(path, file, optimised, robust=robust, solving=solving, started=started)
        write_json(directory / SUMMARY, summary)
    return _format_summary(summary, out)


def _summarise(
    path: Path, file: PoseGraphFile, optimised: OptimisedGraph, *, robust: bool, solving: float, started: float
) -> dict[str, Any]:
    from ...io.host import versions

    graph = file.graph
    return {
        "graph": path.name,
        "poses": len(graph.poses),
        "landmarks": len(graph.landmarks),
        "edges": graph.edge_count,
        "start": "the file's" if file.has_vertices else "along the edges",
        "robust": robust,
        "chi2_before": optimised.chi2_before,
        "chi2_after": optimised.chi2,
        "rejected": _rejected(graph, optimised),
        "warnings": file.notices,
        "solver_seconds": solving,
        "wall_seconds": time.perf_counter() - started,
        "versions": versions(),
    }


def _rejected(graph: PoseGraph, optimised: OptimisedGraph) -> list[dict[str, Any]]:
    """Return the rejected edges: tag, ids of both ends, and line of the file."""
    from ...graph.pose_graph import G2O_EDGES

    out = graph.select_edges(~optimised.inliers)
    return [
        {"tag": tag, "from": source, "to": target, "line": line}
        for edges, tag in zip(out.edges_by_kind, G2O_EDGES.values(), strict=True)
        for source, target, line in zip(
            graph.pose_ids[edges.source].tolist(),
            (graph.pose_ids if edges is out.motions else graph.landmark_ids)[edges.target].tolist(),
            edges.line.tolist(),
            strict=True,
        )
    ]


def _format_summary(summary: dict[str, Any], out: Path) -> list[str]:
    start = "" if summary["start"] == "the file's" else ", with initial poses along the edges, as the file has none"
    rows = [
        ("before", f"chi2 {summary['chi2_before']:.6g}{start}"),
        ("after", f"chi2 {summary['chi2_after']:.6g}"),
    ]
    if summary["robust"]:
        rejected = summary["rejected"]
        named = ", ".join(f"{edge['from']} -> {edge['to']}" for edge in rejected[:SHOWN_REJECTED])
        more = f" and {len(rejected) - SHOWN_REJECTED} more" if len(rejected) > SHOWN_REJECTED else ""
        rows.append(("rejected", f"{len(rejected)} edges{': ' if rejected else ''}{named}{more}"))
    rows += [
        ("time", f"{summary['solver_seconds']:.1f} s for the solver, {summary['wall_seconds']:.1f} s in total"),
        ("results", f"{out}: {', '.join(sorted(entry.name for entry in out.iterdir()))}"),
    ]
    landmarks = f"{summary['landmarks']} landmarks, " if summary["landmarks"] else ""
    head = f"{summary['graph']}: {summary['poses']} poses, {landmarks}{summary['edges']} edges"
    return [head] + [f"  {name:<11}{text}" for name, text in rows]
