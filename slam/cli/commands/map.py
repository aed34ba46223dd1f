"""`wclm map`: export of a map to other file formats."""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...formatting import counted
from ..console import print_message, progress
from ..options import OverwriteOption, RegularOption, SessionArgument

if TYPE_CHECKING:
    from collections.abc import Iterator

    from ...io.exports import PlacedScan
    from ...io.run_results import RunResults


class Format(StrEnum):
    """File formats; the values are the suffixes."""

    PGM = "pgm"
    GEOJSON = "geojson"
    SVG = "svg"
    DXF = "dxf"
    PLY = "ply"
    G2O = "g2o"


REGULAR = (Format.GEOJSON, Format.SVG, Format.DXF)
"""Formats of drawings, in which walls can be made regular."""
MAX_COMPARED = 50
"""Scans of a recording that are compared with those that the session keeps, spread over the drive."""
OF_POINTS = (Format.PGM, Format.PLY)
"""Formats that contain scans, which are read from the recording."""


def export_map(
    session: SessionArgument,
    form: Annotated[
        Format,
        typer.Option(
            "--format",
            help="File format; pgm: ROS occupancy grid, geojson, svg, dxf: walls and corners, ply: points, g2o: graph.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help="Output file; by default map.FORMAT or points.ply in SESSION."),
    ] = None,
    recording: Annotated[
        str | None, typer.Option("--recording", metavar="FILE", help="pgm, ply: recording, if it has been moved.")
    ] = None,
    resolution: Annotated[
        float, typer.Option("--resolution", min=0.001, max=100, help="pgm: cell size in metres.")
    ] = 0.05,
    occupied: Annotated[
        float,
        typer.Option("--occupied", min=0, max=1, help="pgm: min. share of beams ending in an occupied cell, 0 to 1."),
    ] = 0.25,
    free: Annotated[
        float, typer.Option("--free", min=0, max=1, help="pgm: max. share of beams ending in a free cell, 0 to 1.")
    ] = 0.1,
    regular: RegularOption = False,
    overwrite: OverwriteOption = False,
) -> None:
    """Export the map of a session to another file format.

    Example: [bold]wclm map results/intel --format pgm[/bold]
    """
    from ...errors import MapError, OutputError
    from ...io.exports import write_dxf, write_geojson, write_ply, write_svg
    from ...io.output_dir import EXPORTED, POINTS
    from ...io.run_results import read_run_results
    from ...io.unfinished_file import unfinished_file

    if free >= occupied:
        raise typer.BadParameter("must be less than --occupied", param_hint="--free")
    if regular and form not in REGULAR:
        raise typer.BadParameter("is for geojson, svg and dxf", param_hint="--regular")
    if recording is not None and form not in OF_POINTS:
        raise typer.BadParameter("is for pgm and ply", param_hint="--recording")
    read = _regular(session, read_run_results(session)) if regular else read_run_results(session)
    target = out or session / (POINTS if form is Format.PLY else f"{EXPORTED}.{form}")
    if target.suffix != f".{form}":
        raise OutputError(f"{target}: the name must end with .{form}")
    if form is Format.PGM:
        _write_pgm(target, read, recording, resolution, (occupied, free), overwrite)
        return
    with unfinished_file(target, overwrite) as unfinished:
        if form is Format.G2O:
            size = _write_graph(unfinished, session)
        elif form is Format.PLY:
            points = write_ply(unfinished, _scans(read, recording))
            if not points:
                raise MapError(f"{session}: no beam of any scan hit anything, so there are no points")
            size = f"{points} points"
        else:
            {Format.GEOJSON: write_geojson, Format.SVG: write_svg, Format.DXF: write_dxf}[form](unfinished, read)
            size = f"{counted(len(read.walls), 'wall')}, {counted(len(read.corners), 'corner')}"
    typer.echo(f"{target}: {size}")


def _regular(session: Path, results: RunResults) -> RunResults:
    """Return the results with right angles and parallels where the covariances support them, and print how many."""
    from ...io.wall_maps import read_wall_map
    from ...measuring.regularity import regularise

    found = regularise(read_wall_map(session))
    print_message(found.text)
    return replace(results, walls=found.wall_map.walls, corners=found.wall_map.corners)


def _write_pgm(
    target: Path,
    session: RunResults,
    recording: str | None,
    resolution: float,
    thresholds: tuple[float, float],
    overwrite: bool,
) -> None:
    from ...io.exports import OccupancyGrid, Thresholds, write_pgm, write_pgm_yaml
    from ...io.unfinished_file import unfinished_file

    settings = target.with_suffix(".yaml")
    with unfinished_file(target, overwrite) as picture, unfinished_file(settings, overwrite) as yaml:
        grid = OccupancyGrid(resolution)
        grid.add_all(_scans(session, recording))
        occupancy = grid.occupancy(Thresholds(*thresholds))
        write_pgm(picture, occupancy)
        write_pgm_yaml(yaml, occupancy, image=target.name)
    rows, columns = occupancy.cells.shape
    typer.echo(f"{target}: {columns} x {rows} cells of {resolution:g} m; for map_server: {settings}")


def _write_graph(file: Path, session: Path) -> str:
    """Write the factor graph of a session; return its size as text."""
    from ...graph.pose_graph import write_g2o
    from ...io.exports.pose_graph import FIRST_CORNER_ID, FIRST_WALL_ID, build_pose_graph
    from ...io.sessions import read_session
    from ...mapping.convergence import converge

    mapper = read_session(session).slam_state.mapper
    converge(mapper)
    graph = build_pose_graph(mapper)
    write_g2o(file, graph)
    walls = int(((graph.pose_ids >= FIRST_WALL_ID) & (graph.pose_ids < FIRST_CORNER_ID)).sum())
    counts = ((mapper.keyframe_count, "keyframe"), (walls, "wall"), (len(graph.landmarks), "corner"))
    return ", ".join(counted(count, noun) for count, noun in (*counts, (graph.edge_count, "edge")))


def _scans(session: RunResults, recording: str | None) -> Iterator[PlacedScan]:
    """Return the scans of the recording in the map, or those that the session keeps if the run was not recorded.

    If they are other scans than those that the session keeps, the iterator raises MapError at the end.
    """
    from ...io.exports import checked_scans, place_scans, place_stored_scans
    from ...io.recordings import has_recording, open_recording
    from ...io.sessions import is_session, read_session

    kept: Iterator[PlacedScan] = iter(())
    if is_session(session.path):
        stored = read_session(session.path)
        lidars = session.mounts()[:, :2]
        if recording is None and not has_recording(session) and stored.slam_state.mapper.keyframe_count:
            print_message(f"{session.path}: the run was not recorded; the points that its session keeps are used")
            return place_stored_scans(stored, session.trajectory, lidars)
        kept = place_stored_scans(stored, session.trajectory, lidars, MAX_COMPARED)
    source = open_recording(session, recording)
    messages = progress(source, len(source), source.name)
    scans = place_scans(messages, session.trajectory)
    return checked_scans(scans, kept, session.path, source.name)
