"""Pictures of the documentation, from simulated drives and from public recordings if available.

Each picture is computed from a run that is named here; none is drawn by hand.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...events import EventRecorder, Sink, StateChanged
from ...io.output_dir import KEYFRAMES, PICTURE
from ..output_files import make_directory
from .demo_buildings import draw_office_changes, draw_office_plan, draw_second_half
from .demo_drawings import draw_changes, draw_forbidden_loop, draw_grid, draw_map, draw_measurements
from .demo_recorders import ClosureRecorder, true_trajectory

if TYPE_CHECKING:
    from drivers.messages import Source

    from ...mapping.plan_map import PlanMap

OFFICE = "sim:office"
SCAN = 420
"""Index of a scan of the office that shows a furnished room and a part of the corridor."""
LOOP = "sim:museum?lidar=short&odometry=bad"
OPEN_LOOP = f"{LOOP}&duration=110"
"""The same drive before it is back at its start."""
CORRIDORS = {
    "40 m of corridor with doors": "sim:corridor?lidar=short",
    "80 m of bare corridor": "sim:bare_corridor?lidar=short",
}
"""Titles and simulations, with a lidar of 6 m range."""
SYMPTOMS: dict[str, tuple[str, str, dict[str, dict[str, object]]]] = {
    "symptom-loop": (LOOP, "A tour that does not meet its beginning", {"loop_closure": {"enabled": False}}),
    "symptom-delay": (f"{OFFICE}?duration=60", "Scans stamped half a second wrongly", {"lidar": {"delay": 0.5}}),
    "symptom-mount": (
        f"{OFFICE}?duration=60",
        "A lidar that points backwards",
        {"lidar": {"mount": (0.0, 0.0, np.pi)}},
    ),
}
"""Files of pictures of bad maps, with the simulation, the title, and the wrong settings that cause them."""
RECORDINGS = {
    "intel": "Intel Research Lab, Seattle",
    "fr079": "Freiburg University, building 079",
    "csail": "MIT CSAIL, third floor",
}
"""Public recordings (datasets/catalogue.toml) and their titles; files NAME/NAME.clf in the directory WCLM_DATASETS."""
DRAWINGS: dict[str, dict[str, Callable[[Path, Path], None]]] = {
    "intel": {"intel-grid.png": draw_grid, "intel-corrections.png": draw_forbidden_loop},
    "csail": {"csail-measurements.svg": draw_measurements},
}
"""Drawings of the same runs: files, and functions that write them from the results of the run."""
CHANGES = "wean", "wean-2", "wean-3"
"""Directory and names of two recordings along the same corridor."""
CHANGES_DRAWING = "wean-changes.svg"
HALVES, HALVES_DRAWING = "csail", "csail-plan.svg"
"""Recording of which the map of the first half is the plan for the second one."""
PICTURE_DOTS_PER_INCH = 115
"""Resolution of the pictures; they are about 1300 pixels wide."""
COLOURS, SHADES = 200, 256
"""Size of a picture's palette; enough for anti-aliased lines, and reduces the file to a third. More if it is shaded."""


class PictureSet(NamedTuple):
    """Pictures of one run.

    files   names of the files
    make    function that writes them to a directory; its second argument is a temporary directory
    shaded  True if there are large translucent areas, whose shades matter more than rare colours
    needs   recordings that the pictures are made from
    """

    files: tuple[str, ...]
    make: Callable[[Path, Path], None]
    shaded: bool = False
    needs: tuple[Path, ...] = ()


def picture_sets(datasets: Path | None) -> list[PictureSet]:
    """Return all picture sets that can be made; those of recordings if `datasets` has them."""
    return [
        pictures
        for pictures in all_picture_sets(datasets or Path())
        if not pictures.needs or (datasets is not None and all(file.is_file() for file in pictures.needs))
    ]


def all_picture_sets(datasets: Path) -> list[PictureSet]:
    """Return all picture sets, whether or not the directory `datasets` has the recordings that they need."""
    first, second = (datasets / CHANGES[0] / f"{name}.clf" for name in CHANGES[1:])
    halved = datasets / HALVES / f"{HALVES}.clf"
    return [
        PictureSet(("inversion.png", "fit.png", "parameters.png", "corners.png"), _mathematics),
        PictureSet(("scan.png",), _scan),
        PictureSet(("honesty.png",), _office),
        PictureSet(("museum.png", "loop.png"), _loop),
        PictureSet(("confidence.svg",), _open_loop),
        PictureSet(("corridors.png",), _corridors),
        *(_symptom(name, *symptom) for name, symptom in SYMPTOMS.items()),
        *(_recorded(name, datasets / name / f"{name}.clf") for name in RECORDINGS),
        PictureSet(("changes.svg",), partial(draw_office_changes, _map)),
        PictureSet(("plan.svg",), partial(draw_office_plan, _map)),
        PictureSet((CHANGES_DRAWING,), partial(_changes, (first, second)), needs=(first, second)),
        PictureSet((HALVES_DRAWING,), partial(draw_second_half, _map, halved, HALVES_DRAWING), needs=(halved,)),
    ]


def write_pictures(directory: Path) -> Iterator[Path]:
    """Write all pictures into a directory, replacing existing ones; yield each path. Raises SlamError."""
    make_directory(directory)
    import matplotlib

    datasets = os.environ.get("WCLM_DATASETS")
    for pictures in picture_sets(Path(datasets) if datasets else None):
        with TemporaryDirectory() as scratch, matplotlib.rc_context({"savefig.dpi": PICTURE_DOTS_PER_INCH}):
            pictures.make(directory, Path(scratch))
        for file in pictures.files:
            if file.endswith(".png"):
                reduce_palette(directory / file, shaded=pictures.shaded)
            yield directory / file


def reduce_palette(path: Path, *, shaded: bool) -> None:
    """Convert a picture to a palette that includes rare colours, or with `shaded` those of the largest areas."""
    from PIL import Image

    colours, method = (SHADES, Image.Quantize.MEDIANCUT) if shaded else (COLOURS, Image.Quantize.MAXCOVERAGE)
    with Image.open(path) as picture:
        small = picture.convert("RGB").quantize(colours, method, dither=Image.Dither.NONE)
    small.save(path, optimize=True)


def _mathematics(directory: Path, scratch: Path) -> None:
    from ...visualisation.plots import covariance_plots

    covariance_plots.plot_inversion(directory / "inversion.png")
    covariance_plots.plot_fit(directory / "fit.png")
    covariance_plots.plot_parameters(directory / "parameters.png")
    covariance_plots.plot_corners(directory / "corners.png")


def _scan(directory: Path, scratch: Path) -> None:
    from ...config import Config
    from ...visualisation.plots import plot_scan
    from .features import extract_scan

    extracted = extract_scan(OFFICE, SCAN, Config())
    plot_scan(
        directory / "scan.png",
        extracted.scan.ranges,
        extracted.scan.angles,
        extracted.features,
        title="One scan of the office",
    )


def _office(directory: Path, scratch: Path) -> None:
    from ...io.keyframes_csv import read_keyframes
    from ...visualisation.plots.run_plots import plot_consistency

    recorder = _map(OFFICE, scratch / "out")
    keyframes = read_keyframes(scratch / "out" / KEYFRAMES)
    plot_consistency(
        directory / "honesty.png",
        keyframes,
        true_trajectory(recorder),
        title="Errors in the office and their stated deviations",
    )


def _loop(directory: Path, scratch: Path) -> None:
    closure = ClosureRecorder()
    _map(LOOP, scratch / "out", title="A simulated museum", sinks=[closure])
    (directory / "museum.png").write_bytes((scratch / "out" / PICTURE).read_bytes())
    closure.plot(directory / "loop.png")


def _open_loop(directory: Path, scratch: Path) -> None:
    """Draw the map of the drive before its loop is closed, with its confidence map."""
    _map(OPEN_LOOP, scratch / "out")
    draw_map(directory / "confidence.svg", scratch / "out")


def _corridors(directory: Path, scratch: Path) -> None:
    from ...io.keyframes_csv import read_keyframes
    from ...visualisation.plots.run_plots import CorridorRun, plot_corridors

    drives: list[CorridorRun] = []
    for name, spec in CORRIDORS.items():
        out = scratch / str(len(drives))
        recorder = _map(spec, out)
        drives.append(
            CorridorRun(name, read_keyframes(out / KEYFRAMES), true_trajectory(recorder), recorder.of(StateChanged))
        )
    plot_corridors(directory / "corridors.png", drives, title="There and back: uncertainty along the corridor")


def _symptom(name: str, spec: str, title: str, settings: dict[str, dict[str, object]]) -> PictureSet:
    def make(directory: Path, scratch: Path) -> None:
        _map(spec, scratch / "out", title=title, settings=settings)
        (directory / f"{name}.png").write_bytes((scratch / "out" / PICTURE).read_bytes())

    return PictureSet((f"{name}.png",), make, shaded=True)


def _recorded(name: str, recording: Path) -> PictureSet:
    def make(directory: Path, scratch: Path) -> None:
        _map(str(recording), scratch / "out", title=RECORDINGS[name])
        (directory / f"{name}.png").write_bytes((scratch / "out" / PICTURE).read_bytes())
        for file, draw in drawings.items():
            draw(directory / file, scratch / "out")

    drawings = DRAWINGS.get(name, {})
    return PictureSet((f"{name}.png", *drawings), make, needs=(recording,))


def _changes(recordings: tuple[Path, Path], directory: Path, scratch: Path) -> None:
    """Draw the differences between the maps of two recordings."""
    outs = scratch / "old", scratch / "new"
    for recording, out in zip(recordings, outs, strict=True):
        _map(str(recording), out)
    draw_changes(directory / CHANGES_DRAWING, *outs)


def _map(
    source: str | Source,
    out: Path,
    *,
    title: str | None = None,
    sinks: Sequence[Sink] = (),
    settings: Mapping[str, object] = MappingProxyType({}),
    plan: PlanMap | None = None,
) -> EventRecorder:
    """Map a recording or a simulation, or what names one, into `out` as `wclm run --plot` does; return its events."""
    import drivers

    from ...config import Config
    from ...io.recordings import absolute_recording
    from ...run_setup import RunSetup
    from ..run_input import RecordingInput
    from ..slam_run import run_slam

    recorder = EventRecorder()
    opened = drivers.open(source) if isinstance(source, str) else source
    run_input = RecordingInput(opened, reopen=absolute_recording(source if isinstance(source, str) else opened.name))
    run_input.name, run_input.sinks = title or run_input.name, [recorder, *sinks]
    setup = RunSetup(Config.model_validate(settings), plan=plan)
    run_slam(run_input, setup, out, overwrite=False, review=False, picture=True)
    return recorder
