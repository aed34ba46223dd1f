"""`wclm map`: a session's map for other programs."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..console import progress
from ..options import OverwriteOption

if TYPE_CHECKING:
    from collections.abc import Iterator

    from ...io.exports import PlacedScan, Thresholds
    from ...io.run_results import RunResults


class Format(StrEnum):
    """What can be written; the names' endings."""

    PGM = "pgm"
    GEOJSON = "geojson"
    SVG = "svg"
    DXF = "dxf"
    PLY = "ply"
    G2O = "g2o"


def export_map(
    session: Annotated[Path, typer.Argument(help="The directory that `wclm run --out DIR` left.")],
    form: Annotated[
        Format,
        typer.Option("--format", help="pgm: occupancy for ROS, with its YAML; ply: the scans' points; g2o: the graph."),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="Without it: map.FORMAT or points.ply in SESSION.")
    ] = None,
    recording: Annotated[
        str | None, typer.Option("--recording", metavar="FILE", help="For pgm and ply, where the recording has moved.")
    ] = None,
    resolution: Annotated[
        float, typer.Option("--resolution", min=0.001, help="pgm: metres that a cell is wide.")
    ] = 0.05,
    occupied: Annotated[
        float, typer.Option("--occupied", min=0, max=1, help="pgm: the least share of beams that end in a wall's cell.")
    ] = 0.25,
    free: Annotated[
        float, typer.Option("--free", min=0, max=1, help="pgm: the largest share that ends in a free cell.")
    ] = 0.1,
    overwrite: OverwriteOption = False,
) -> None:
    """Write a session's map for other programs.

    Example: [bold]wclm map results/intel --format pgm[/bold]
    """
    from ...errors import OutputError
    from ...io.exports import Thresholds, write_dxf, write_geojson, write_ply, write_svg
    from ...io.output_dir import EXPORTED, POINTS, unfinished_file
    from ...io.run_results import read_run_results

    if free >= occupied:
        raise typer.BadParameter("must be less than --occupied", param_hint="--free")
    read = read_run_results(session)
    target = out or session / (POINTS if form is Format.PLY else f"{EXPORTED}.{form}")
    if target.suffix != f".{form}":
        raise OutputError(f"{target}: the name of a {form} file must end with .{form}")
    if form is Format.PGM:
        _write_pgm(target, read, recording, resolution, Thresholds(occupied, free), overwrite)
        return
    with unfinished_file(target, overwrite) as unfinished:
        if form is Format.G2O:
            told = _write_graph(unfinished, session)
        elif form is Format.PLY:
            points = write_ply(unfinished, _scans(read, recording))
            _expect(points, read, recording)
            told = f"{points} points"
        else:
            {Format.GEOJSON: write_geojson, Format.SVG: write_svg, Format.DXF: write_dxf}[form](unfinished, read)
            told = f"{len(read.lines)} walls, {len(read.corners)} corners"
    typer.echo(f"{target}: {told}")


def _write_pgm(
    target: Path, session: RunResults, recording: str | None, resolution: float, thresholds: Thresholds, overwrite: bool
) -> None:
    from ...io.exports import OccupancyGrid, write_pgm, write_pgm_yaml
    from ...io.output_dir import unfinished_file

    settings = target.with_suffix(".yaml")
    with unfinished_file(target, overwrite) as picture, unfinished_file(settings, overwrite) as yaml:
        grid = OccupancyGrid(resolution)
        _expect(grid.add_all(_scans(session, recording)), session, recording)
        occupancy = grid.occupancy(thresholds)
        write_pgm(picture, occupancy)
        write_pgm_yaml(yaml, occupancy, image=target.name)
    rows, columns = occupancy.cells.shape
    typer.echo(f"{target}: {columns} x {rows} cells of {resolution:g} m; for map_server: {settings}")


def _write_graph(file: Path, session: Path) -> str:
    """The session's factor graph; what a person should know of it."""
    from ...graph.pose_graph import write_g2o
    from ...io.exports.pose_graph import build_pose_graph
    from ...io.sessions import read_session

    mapper = read_session(session).slam_state.mapper
    mapper.converge()
    graph = build_pose_graph(mapper)
    write_g2o(file, graph)
    walls = len(graph.poses) - mapper.keyframe_count
    return f"{mapper.keyframe_count} keyframes, {walls} walls, {len(graph.landmarks)} corners, {graph.edge_count} edges"


def _scans(session: RunResults, recording: str | None) -> Iterator[PlacedScan]:
    from ...io.exports import place_scans
    from ...io.recordings import open_recording

    source = open_recording(session, recording)
    messages = progress(source, len(source), source.name)
    return place_scans(messages, session.trajectory, session.config().lidar)


def _expect(count: int, session: RunResults, recording: str | None) -> None:
    """A recording of another drive has nothing at the times of the path."""
    from ...errors import MapError

    if not count:
        name = recording or session.summary.get("recording_path")
        raise MapError(f"{session.path}: {name} has no scan from the time of its path; is it another recording?")
