"""Drawings of the documentation that are made from the results of runs, as commands make them."""

from __future__ import annotations

from pathlib import Path

GRID_RESOLUTION = 0.05
"""Metres of a cell of the occupancy grid, as by default of `wclm map`."""
FALSE_DISCOVERY_RATE = 0.05


def draw_grid(path: Path, session: Path) -> None:
    """Draw the occupancy grid of a run as `wclm map --format pgm` does, as PNG. Raises SlamError."""
    from PIL import Image

    from ...io.exports import OccupancyGrid, Thresholds, place_scans, write_pgm
    from ...io.recordings import open_recording
    from ...io.run_results import read_run_results

    results = read_run_results(session)
    grid = OccupancyGrid(GRID_RESOLUTION)
    grid.add_all(place_scans(open_recording(results, None), results.trajectory, results.config()))
    picture = path.with_suffix(".pgm")
    write_pgm(picture, grid.occupancy(Thresholds()))
    with Image.open(picture) as image:
        image.save(path)
    picture.unlink()


def draw_measurements(path: Path, session: Path) -> None:
    """Draw a map with its measurements as `wclm measure --format svg` does. Raises SlamError."""
    from ...io.exports import write_svg
    from ...io.run_results import read_run_results
    from ...io.wall_maps import read_wall_map
    from ...measuring.measured_map import measure_all

    write_svg(path, read_run_results(session), measure_all(read_wall_map(session)))


def draw_changes(path: Path, old: Path, new: Path) -> None:
    """Draw the differences between the maps of two runs as `wclm diff --svg` does. Raises SlamError."""
    from ...io.sessions import read_session
    from ...offline.map_diff import compare, survey_session
    from ...offline.map_diff.outputs import write_diff_svg

    before, after = (survey_session(run, read_session(run)) for run in (old, new))
    found = compare(before, after, FALSE_DISCOVERY_RATE)
    write_diff_svg(path, found, before.wall_map, after.wall_map)
