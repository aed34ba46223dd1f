"""The pictures of the documentation, all made again: from simulated drives, and from recordings where they are at hand.

Each picture is what the program makes of a run that is named here; nothing is drawn by hand.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple, TypeVar

import numpy as np

from ...errors import MapError, OutputError
from ...events import Event, GroundTruthReceived, KeyframeAdded, LoopDecided, MapUpdated, StateChanged
from ...io.output_dir import KEYFRAMES, PICTURE
from ...io.tum import Trajectory
from ...loop_closure.loop_status import LoopStatus

OFFICE = "sim:office"
SCAN = 420
"""Of the office: taken in a room with furniture, with a view down the corridor."""
LOOP = "sim:large_loop?lidar=short&odometry=bad&seed=0"
CORRIDORS = {
    "40 m of corridor with doors": "sim:corridor?lidar=short",
    "80 m of bare corridor": "sim:bare_corridor?lidar=short",
}
"""By a lidar that sees 6 m far."""
RECORDINGS = {
    "intel": "Intel Research Lab, Seattle",
    "fr079": "Freiburg University, building 079",
    "csail": "MIT CSAIL, third floor",
}
"""Public recordings (datasets/catalogue.toml), looked for as NAME/NAME.clf in the folder that WCLM_DATASETS names."""
DOTS_PER_INCH = 115
"""Pictures some 1300 pixels wide: what a page shows, even on a fine screen."""
COLOURS = 200
"""Of a picture's palette: lines and their soft edges need no more, and the file has a third of the size."""

Kind = TypeVar("Kind")


class PictureSet(NamedTuple):
    """Pictures of one run: their files' names, and what makes them in a directory, given another for what it needs."""

    files: tuple[str, ...]
    make: Callable[[Path, Path], None]


class EventRecorder:
    """A sink that keeps what was told."""

    def __init__(self) -> None:
        self.events: list[Event] = []

    def handle(self, event: Event) -> None:
        """Take one event."""
        self.events.append(event)

    def of(self, kind: type[Kind]) -> list[Kind]:
        """All events of one kind, in their order."""
        return [event for event in self.events if isinstance(event, kind)]

    def truth(self) -> Trajectory:
        """The true path, in the world's frame."""
        seen = self.of(GroundTruthReceived)
        return Trajectory(np.array([event.stamp for event in seen]), np.array([event.pose for event in seen]))


def gallery(datasets: Path | None) -> list[PictureSet]:
    """All that can be made: pictures of recordings where `datasets` has those."""
    return [
        PictureSet(("inversion.png", "fit.png", "parameters.png", "corners.png"), _mathematics),
        PictureSet(("scan.png",), _scan),
        PictureSet(("office.png", "honesty.png"), _office),
        PictureSet(("loop.png",), _loop),
        PictureSet(("corridors.png",), _corridors),
        *(
            _recorded(name, file)
            for name in RECORDINGS
            if datasets is not None and (file := datasets / name / f"{name}.clf").is_file()
        ),
    ]


def write_pictures(directory: Path) -> Iterator[Path]:
    """Write all pictures into a directory, over those that are there; each path when it is done. Raises SlamError."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{directory}: cannot be made: {error.strerror or error}") from error
    import matplotlib

    datasets = os.environ.get("WCLM_DATASETS")
    for pictures in gallery(Path(datasets) if datasets else None):
        with TemporaryDirectory() as scratch, matplotlib.rc_context({"savefig.dpi": DOTS_PER_INCH}):
            pictures.make(directory, Path(scratch))
        for file in pictures.files:
            reduce_palette(directory / file)
            yield directory / file


def reduce_palette(path: Path) -> None:
    """Give a picture a palette that has rare colours, too."""
    from PIL import Image

    with Image.open(path) as picture:
        small = picture.convert("RGB").quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    small.save(path, optimize=True)


def _mathematics(directory: Path, scratch: Path) -> None:
    from ...visualisation.plots import mathematics

    mathematics.plot_inversion(directory / "inversion.png")
    mathematics.plot_fit(directory / "fit.png")
    mathematics.plot_parameters(directory / "parameters.png")
    mathematics.plot_corners(directory / "corners.png")


def _scan(directory: Path, scratch: Path) -> None:
    from ...config import Config
    from ...visualisation.plots import plot_scan
    from .features import extract_scan

    seen = extract_scan(OFFICE, SCAN, Config())
    plot_scan(directory / "scan.png", seen.scan.ranges, seen.scan.angles, seen.features, title="One scan of the office")


def _office(directory: Path, scratch: Path) -> None:
    from ...io.keyframes_csv import read_keyframes
    from ...visualisation.plots.drives import plot_honesty

    told = _map(OFFICE, scratch / "out", title="A simulated office")
    (directory / "office.png").write_bytes((scratch / "out" / PICTURE).read_bytes())
    keyframes = read_keyframes(scratch / "out" / KEYFRAMES)
    plot_honesty(
        directory / "honesty.png", keyframes, told.truth(), title="Errors in the office, and what is claimed of them"
    )


def _loop(directory: Path, scratch: Path) -> None:
    from ...visualisation.plots.drives import plot_closure

    told = _map(LOOP, scratch / "out")
    accepted = [event for event in told.of(LoopDecided) if event.status == LoopStatus.ACCEPTED]
    if not accepted:
        raise MapError(f"{LOOP}: no loop was closed")
    decided = max(accepted, key=lambda event: event.shift)
    place = told.events.index(decided)
    maps = [(k, event) for k, event in enumerate(told.events) if isinstance(event, MapUpdated)]
    last, before = next((k, event) for k, event in reversed(maps) if k < place)
    after = next(event for k, event in maps if k > place)
    added = [event for event in told.events[last:place] if isinstance(event, KeyframeAdded)]
    since = [event.pose for event in added if event.index < decided.index]  # that one is told of as it is afterwards
    path = np.concatenate([before.keyframes, np.reshape(since, (-1, 3))])
    plot_closure(directory / "loop.png", before, path, decided, after)


def _corridors(directory: Path, scratch: Path) -> None:
    from ...io.keyframes_csv import read_keyframes
    from ...visualisation.plots.drives import Corridor, plot_corridors

    drives: list[Corridor] = []
    for name, spec in CORRIDORS.items():
        out = scratch / str(len(drives))
        told = _map(spec, out)
        drives.append(Corridor(name, read_keyframes(out / KEYFRAMES), told.truth(), told.of(StateChanged)))
    plot_corridors(directory / "corridors.png", drives, title="There and back: how well it is known how far")


def _recorded(name: str, recording: Path) -> PictureSet:
    def make(directory: Path, scratch: Path) -> None:
        _map(str(recording), scratch / "out", title=RECORDINGS[name])
        (directory / f"{name}.png").write_bytes((scratch / "out" / PICTURE).read_bytes())

    return PictureSet((f"{name}.png",), make)


def _map(spec: str, out: Path, *, title: str | None = None) -> EventRecorder:
    """Map a recording or a simulation into `out` as `wclm run --plot` does; all that was told on the way."""
    import drivers

    from ...config import Config
    from ..run_input import RecordingInput, absolute_source
    from ..slam_run import run_slam

    witness = EventRecorder()
    run_input = RecordingInput(drivers.open(spec), reopen=absolute_source(spec))
    run_input.name, run_input.sinks = title or run_input.name, [witness]
    run_slam(run_input, Config(), out, overwrite=False, review=False, picture=True)
    return witness
