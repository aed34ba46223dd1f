"""`wclm optimize`: pose graphs here, sessions and recordings beside."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..console import print_message
from ..options import ConfigOption, OverwriteOption, ReviewOption, SetOption

if TYPE_CHECKING:
    from ...graph.pose_graph import Optimised, PoseGraph, PoseGraphFile

POSE_GRAPHS = (".g2o", ".graph", ".toro")
"""Endings of pose graphs' names: g2o's, and the two in use for TORO's."""
SHOWN_REJECTED = 4


def optimize(
    what: Annotated[
        str,
        typer.Argument(
            metavar="SESSION|RECORDING|GRAPH",
            help="What `wclm run` left, a recording, or a 2-D pose graph of g2o or TORO (.g2o, .graph, .toro).",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", help="Directory for the results; made if it is not there.")],
    overwrite: OverwriteOption = False,
    robust: Annotated[
        bool,
        typer.Option(
            "--robust", help="A graph: leave out edges that contradict the others; from pose to next pose all stay in."
        ),
    ] = False,
    config: ConfigOption = None,
    settings: SetOption = None,
    review: ReviewOption = True,
    plot: Annotated[bool, typer.Option("--plot", help="Draw the map, or the graph before and after, too.")] = False,
) -> None:
    """Take the time to look at everything again: associate anew, solve in batch, until it settles.

    A session or a recording gives another session, a graph gives graph.g2o. Settings are for recordings: a session has
    its own.

    Example: [bold]wclm optimize results/intel --out results/intel-optimised[/bold]
    """
    from ...io.output_dir import MAP
    from ...io.sessions import is_session

    path = Path(what)
    if path.suffix.lower() in POSE_GRAPHS:
        _optimize_pose_graph(path, out, overwrite=overwrite, robust=robust, picture=plot)
        return
    from .optimize_session import optimize_recording, optimize_session

    if is_session(path) or (path / MAP).is_file():
        lines = optimize_session(path, out, overwrite=overwrite, review=review, picture=plot)
    else:
        from ...config import load_config

        effective = load_config(config, settings or ())
        lines = optimize_recording(what, effective, out, overwrite=overwrite, review=review, picture=plot)
    typer.echo("\n".join(lines))


def _optimize_pose_graph(path: Path, out: Path, *, overwrite: bool, robust: bool, picture: bool) -> None:
    from ...graph.pose_graph import optimise, read_pose_graph, write_g2o
    from ...io.output_dir import GRAPH, GRAPH_PICTURE, SUMMARY, OutputDirectory, write_json

    started = time.perf_counter()
    with OutputDirectory(out, overwrite) as directory:
        file = read_pose_graph(path)
        for notice in file.notices:
            print_message(notice)
        before = time.perf_counter()
        optimised = optimise(file.graph, robust)
        solving = time.perf_counter() - before
        write_g2o(directory / GRAPH, optimised.graph)
        if picture:
            from ...visualisation.plots import plot_pose_graph

            plot_pose_graph(directory / GRAPH_PICTURE, file.graph, optimised, title=path.name)
        summary = _summarise(path, file, optimised, robust=robust, solving=solving, started=started)
        write_json(directory / SUMMARY, summary)
    typer.echo("\n".join(_lines_for_people(summary, out)))


def _summarise(
    path: Path, file: PoseGraphFile, optimised: Optimised, *, robust: bool, solving: float, started: float
) -> dict[str, Any]:
    from ...io.host import versions

    graph = file.graph
    return {
        "graph": path.name,
        "poses": len(graph.poses),
        "landmarks": len(graph.landmarks),
        "edges": graph.edge_count,
        "start": "the file's" if file.placed else "along the edges",
        "robust": robust,
        "chi2_before": optimised.chi2_before,
        "chi2_after": optimised.chi2,
        "rejected": _rejected(graph, optimised),
        "warnings": file.notices,
        "solver_seconds": solving,
        "wall_seconds": time.perf_counter() - started,
        "versions": versions(),
    }


def _rejected(graph: PoseGraph, optimised: Optimised) -> list[dict[str, Any]]:
    """The edges that were left out, by the ids they connect and the line of the file that tells of them."""
    from ...graph.pose_graph import G2O_EDGES

    out = graph.select_edges(~optimised.kept)
    return [
        {"tag": tag, "from": source, "to": target, "line": line}
        for edges, tag in zip(out.kinds, G2O_EDGES.values(), strict=True)
        for source, target, line in zip(
            graph.pose_ids[edges.source].tolist(),
            (graph.pose_ids if edges is out.motions else graph.landmark_ids)[edges.target].tolist(),
            edges.line.tolist(),
            strict=True,
        )
    ]


def _lines_for_people(summary: dict[str, Any], out: Path) -> list[str]:
    start = "" if summary["start"] == "the file's" else ", with the poses placed along the edges: the file has none"
    rows = [
        ("before", f"chi2 {summary['chi2_before']:.6g}{start}"),
        ("after", f"chi2 {summary['chi2_after']:.6g}"),
    ]
    if summary["robust"]:
        rejected = summary["rejected"]
        named = ", ".join(f"{edge['from']} -> {edge['to']}" for edge in rejected[:SHOWN_REJECTED])
        more = f" and {len(rejected) - SHOWN_REJECTED} more" if len(rejected) > SHOWN_REJECTED else ""
        rows.append(("left out", f"{len(rejected)} edges{': ' if rejected else ''}{named}{more}"))
    rows += [
        ("time", f"{summary['solver_seconds']:.1f} s for the optimum, {summary['wall_seconds']:.1f} s in all"),
        ("results", f"{out}: {', '.join(sorted(entry.name for entry in out.iterdir()))}"),
    ]
    landmarks = f"{summary['landmarks']} landmarks, " if summary["landmarks"] else ""
    head = f"{summary['graph']}: {summary['poses']} poses, {landmarks}{summary['edges']} edges"
    return [head] + [f"  {name:<11}{text}" for name, text in rows]
