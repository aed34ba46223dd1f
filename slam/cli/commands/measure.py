"""`wclm measure`: distances, lengths, angles and rooms of a map, with standard deviations."""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...formatting import counted, percent
from ..console import print_if_slow, print_message
from ..options import OverwriteOption, RegularOption, SessionArgument

if TYPE_CHECKING:
    from ...measuring.measured_map import MeasuredMap
    from ...measuring.measurement import Measurement
    from ...measuring.wall_map import WallMap


# What is printed without measurements, of the whole map and of given walls.
NOTHING = (
    "nothing to measure: no room is closed, and no walls are opposite each other",
    "nothing to measure: a wall has a length between two corners only, and a distance or angle to another wall",
)


class Format(StrEnum):
    """Output formats."""

    TEXT = "text"
    CSV = "csv"
    SVG = "svg"
    DXF = "dxf"
    GEOJSON = "geojson"

    @property
    def suffix(self) -> str:
        """Suffix of a file in this format."""
        return ".txt" if self is Format.TEXT else f".{self}"


def measure(
    session: SessionArgument,
    walls: Annotated[
        list[int] | None,
        typer.Argument(metavar="WALL", help="Identities of walls, as in map.json; by default the whole map."),
    ] = None,
    form: Annotated[
        Format,
        typer.Option(
            "--format",
            help="text; csv: table; svg, dxf: drawing with rooms, doors and dimension lines; geojson: rooms and doors.",
        ),
    ] = Format.TEXT,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="FILE", help="Output file; of drawings and geojson by default measurements.FORMAT."
        ),
    ] = None,
    regular: RegularOption = False,
    overwrite: OverwriteOption = False,
) -> None:
    """Measure a map: distances between walls, lengths, angles, and areas of rooms, with standard deviations.

    Of the whole map: rooms with their areas, sides and angles; lengths of other walls between two corners; widths
    between walls that face each other, and thicknesses of walls; doors and passages. With identities of walls: their
    lengths, and the distance or angle of each two of them. Standard deviations follow from the joint covariance of all
    walls.

    Example: [bold]wclm measure results/office 12 17[/bold]
    """
    from ...errors import OutputError
    from ...io.exports.measurements_csv import measurements_csv
    from ...io.output_dir import MEASURED
    from ...io.unfinished_file import unfinished_file
    from ...io.wall_maps import read_wall_map
    from ...measuring.map_measurements import measure_walls
    from ...measuring.measured_map import MeasuredMap, measure_all
    from ...measuring.regularity import regularise
    from ..setup_from_options import READING_SESSION

    drawn = form in (Format.SVG, Format.DXF, Format.GEOJSON)
    target = out or (session / f"{MEASURED}{form.suffix}" if drawn else None)
    if target is not None and target.suffix != form.suffix:
        raise OutputError(f"{target}: the name must end with {form.suffix} for --format {form}")
    with print_if_slow(READING_SESSION):
        wall_map = read_wall_map(session)
    if regular:
        found = regularise(wall_map)
        print_message(found.text)
        wall_map = found.wall_map
    measured = MeasuredMap(measure_walls(wall_map, walls)) if walls else measure_all(wall_map)
    table = measurements_csv(measured) if form is Format.CSV else _as_text(measured) or NOTHING[bool(walls)]
    if target is None:
        typer.echo(table.rstrip("\n"))
        return
    with unfinished_file(target, overwrite) as unfinished:
        if drawn:
            _write_drawing(unfinished, form, session, measured, wall_map if regular else None)
        else:
            unfinished.write_text(f"{table.rstrip()}\n", encoding="utf-8", newline="\n")
    openings = f"{len(measured.openings)} doors and passages"
    measurements = counted(len(measured.measurements), "measurement")
    typer.echo(f"{target}: {counted(len(measured.rooms), 'room')}, {openings}, {measurements}")


def _write_drawing(path: Path, form: Format, session: Path, measured: MeasuredMap, wall_map: WallMap | None) -> None:
    """Write a map with its measurements as SVG, DXF or GeoJSON, with the walls of `wall_map` if there are others."""
    from ...io.exports import write_dxf, write_geojson, write_svg
    from ...io.run_results import read_run_results

    results = read_run_results(session)
    if wall_map is not None:
        results = replace(results, walls=wall_map.walls, corners=wall_map.corners)
    write = {Format.SVG: write_svg, Format.DXF: write_dxf, Format.GEOJSON: write_geojson}[form]
    write(path, results, measured)


def _as_text(measured: MeasuredMap) -> str:
    """Return one line per measurement, below a line per room, then one per door or passage."""
    lines, room = [], None
    for one in measured.measurements:
        if one.room != room and one.room is not None:
            lines.append(f"room {one.room}: {percent(measured.rooms[one.room - 1].observed)} of the outline was seen")
        room = one.room
        lines.append(f"{'  ' if room is not None else ''}{one.kind}{_of_walls(one)}: {_with_deviation(one)}")
    for opening in measured.openings:
        walls = ("wall " if len(opening.walls) == 1 else "walls ") + ", ".join(map(str, opening.walls))
        rooms = " and ".join(f"room {number}" for number in opening.rooms)
        lines.append(f"{opening.name} in {walls}: {opening.width:.1f} m" + (f", to {rooms}" if rooms else ""))
    return "\n".join(lines)


def _of_walls(one: Measurement) -> str:
    """Return the wall that was measured, or both; nothing for a measurement of a whole room."""
    if one.unit == "m2" or one.kind == "perimeter":
        return ""
    return f" of wall {one.walls[0]}" if len(one.walls) == 1 else f" between walls {' and '.join(map(str, one.walls))}"


def _with_deviation(one: Measurement) -> str:
    """Return value and standard deviation in units for reading."""
    from math import degrees

    if one.unit == "rad":
        return f"{degrees(one.value):.3f}° ± {degrees(one.sigma):.3f}°"
    if one.unit == "m2":
        return f"{one.value:.3f} m² ± {one.sigma:.3f} m²"
    return f"{one.value:.4f} m ± {1e3 * one.sigma:.1f} mm"
