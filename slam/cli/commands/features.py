"""`wclm features`: the features extracted from one scan."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from ..options import OtherRecordingArgument, SetOption, check_picture

if TYPE_CHECKING:
    from drivers.messages import Scan
    from features.types import Features

    from ...config import Config


class ExtractedScan(NamedTuple):
    """A scan, its features, and the name of the source that it is from."""

    source: str
    scan: Scan
    features: Features


def features(
    recording: OtherRecordingArgument,
    scan: Annotated[int, typer.Option("--scan", min=0, help="Index of the scan, from 0.")],
    plot: Annotated[
        Path | None,
        typer.Option(
            "--plot", metavar="FILE.png", callback=check_picture, help="Picture of the scan and its features."
        ),
    ] = None,
    settings: SetOption = None,
) -> None:
    """Print the lines and corners extracted from one scan, with standard deviations.

    Example: [bold]wclm features intel.clf --scan 100 --plot scan.png[/bold]
    """
    from ...config import load_config

    seen = extract_scan(recording, scan, load_config(None, settings or ()))
    title = f"{seen.source}, scan {scan}"
    typer.echo(f"{title} at {seen.scan.stamp:.3f} s\n{table(seen.features)}")
    if plot is not None:
        from ...visualisation.plots import plot_scan

        plot_scan(plot, seen.scan.ranges, seen.scan.angles, seen.features, title=title)


def extract_scan(recording: str, number: int, config: Config) -> ExtractedScan:
    """Extract the features of scan `number` of a recording, from 0. Raises RecordingError if there is no such scan."""
    from drivers.errors import RecordingError
    from drivers.messages import Scan

    from ...io.recordings import open_source
    from ...preprocessing.extraction import build_extractor

    extractor, bias = build_extractor(config.lidar, config.features), config.lidar.range_bias
    source = open_source(recording, config)
    scans = (message for message in source if isinstance(message, Scan))
    count = 0
    for found in islice(scans, number + 1):
        extracted = extractor.extract(found.ranges - bias, found.angles)  # every scan, as the noise estimate adapts
        count += 1
    if count <= number:
        raise RecordingError(recording, None, f"has {count} scans, from 0; there is no scan {number}")
    return ExtractedScan(source.name, replace(found, ranges=found.ranges - bias), extracted)


def table(extracted: Features) -> str:
    """Return lines and corners as text; the deviation of the offset is that at the segment's centre."""
    import numpy as np

    from ...geometry.line_segments import segments_from_lines

    segments = segments_from_lines(extracted.lines, np.zeros(3))
    sigma = np.sqrt(np.diagonal(segments.covariance, axis1=1, axis2=2))
    rows = ["line  rays  length m  distance m  bearing deg  sigma offset mm  sigma heading deg"]
    for k, uv in enumerate(extracted.lines.uv):
        rows.append(
            f"{k:4d} {extracted.lines.count[k]:5d} {2 * segments.half_length[k]:9.3f} {1 / np.hypot(*uv):11.3f} "
            f"{np.degrees(np.arctan2(uv[1], uv[0])):12.2f} {1000 * sigma[k, 0]:16.2f} {np.degrees(sigma[k, 1]):18.3f}"
        )
    rows.append("corner  lines      x m       y m      max sigma mm")
    for k, position in enumerate(extracted.corners.position):
        before, after = extracted.corners.lines[k]
        largest = 1000 * np.sqrt(np.linalg.eigvalsh(extracted.corners.covariance[k])[-1])
        rows.append(f"{k:6d} {before:3d},{after:2d} {position[0]:8.3f} {position[1]:9.3f} {largest:17.2f}")
    return "\n".join(rows)
