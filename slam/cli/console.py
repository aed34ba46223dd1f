"""What commands say while they work and when they fail: on stderr, so that stdout holds nothing but results."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Timer
from typing import Annotated, TypeVar

import typer

MISTAKE = 2
"""Exit status for what the user can mend; also typer's for wrong usage."""
INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""
EVERY = 20
"""Items between two looks at the progress bar."""

SLOW = 2.0
"""Seconds after which a person wants to know what is going on."""

Item = TypeVar("Item")

SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="GROUP.KEY=VALUE", help="Change one setting, e.g. lidar.sigma_range=0.02; may be repeated."
    ),
]
ConfigOption = Annotated[Path | None, typer.Option("--config", help="Settings, a TOML file.")]
OutOption = Annotated[Path, typer.Option("--out", help="Directory for the results; made if it is not there.")]
ReviewOption = Annotated[bool, typer.Option("--review/--no-review", help="Write the log for the viewer.")]
PlotOption = Annotated[bool, typer.Option("--plot", help="Draw the map as map.png, too.")]
DurationOption = Annotated[float | None, typer.Option("--duration", min=0.0, help="Seconds; without it until Ctrl-C.")]
OverwriteOption = Annotated[bool, typer.Option("--overwrite", help="Replace results that are there already.")]

ContinueOption = Annotated[
    Path | None, typer.Option("--continue", metavar="SESSION", help="Go on with the map that a run left in SESSION.")
]
LocalizeOption = Annotated[
    Path | None,
    typer.Option("--localize", metavar="SESSION", help="Only find the path on the map in SESSION; it stays as it is."),
]
RefineOption = Annotated[bool, typer.Option("--refine", help="Look at everything again after the last scan.")]


def complain(text: str) -> None:
    """One line on stderr, whatever the text is."""
    typer.echo(f"wclm: {' '.join(text.split())}", err=True)


@contextmanager
def say_if_slow(text: str) -> Iterator[None]:
    """Say `text` on stderr if what is inside the context takes its time."""
    timer = Timer(SLOW, complain, [text])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def progress(items: Iterable[Item], total: int, doing: str) -> Iterator[Item]:
    """The same items, with a progress bar on stderr if that is a terminal; `total` 0 means that nobody knows."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield from items
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(doing, total=total or None)
        for count, item in enumerate(items):
            if count % EVERY == 0:
                bar.update(task, completed=count)
            yield item
