"""Drawings of the documentation that are made from the results of runs, as commands make them."""

from __future__ import annotations

from pathlib import Path

from ...errors import MapError

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
    grid.add_all(place_scans(open_recording(results, None), results.trajectory))
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


def draw_map(path: Path, session: Path) -> None:
    """Draw a map with its confidence map as `wclm map --format svg` does. Raises SlamError."""
    from ...io.exports import write_svg
    from ...io.run_results import read_run_results

    write_svg(path, read_run_results(session))


def draw_changes(path: Path, old: Path, new: Path) -> None:
    """Draw the differences between the maps of two runs as `wclm diff --svg` does. Raises SlamError."""
    from ...io.sessions import read_session
    from ...offline.map_diff import compare, survey_session
    from ...offline.map_diff.outputs import write_diff_svg

    before, after = (survey_session(run, read_session(run)) for run in (old, new))
    found = compare(before, after, FALSE_DISCOVERY_RATE)
    write_diff_svg(path, found, before.wall_map, after.wall_map)


def draw_forbidden_loop(path: Path, session: Path) -> None:
    """Draw what `wclm correct --forbid-loop` changes around the last closed loop of a run. Raises SlamError."""
    from ...io.run_results import read_run_results
    from ...io.sessions import read_session
    from ...loop_closure.loop_status import LoopStatus
    from ...session_correction import correct
    from ...visualisation.plots.correction import plot_correction

    rows = [row for row in read_session(session).loop_decisions if row["status"] == LoopStatus.ACCEPTED]
    if not rows:
        raise MapError(f"{session}: no loop was closed")
    loop, visits = int(rows[-1]["candidate"]), (int(rows[-1]["old"]), int(rows[-1]["keyframe"]))
    corrected = session.with_name(f"{session.name}-corrected")
    correct(session, forbid_loop=[loop], out=corrected)
    before, after = read_run_results(session), read_run_results(corrected)
    moved = after.summary["corrections"][0]["shift"]
    plot_correction(
        path,
        before,
        after,
        visits,
        (f"loop {loop} is closed", f"loop {loop} is forbidden: keyframe {visits[1]} moves by {moved:.2f} m"),
        title="A corridor that was driven twice, with and without the loop",
    )
