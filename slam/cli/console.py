"""Messages and progress of commands on stderr, so that stdout holds only results."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from threading import Timer
from typing import TypeVar

EXIT_USER_ERROR = 2
"""Exit status of errors that the user can correct; typer uses the same for wrong usage."""
EXIT_INTERRUPTED = 130
"""Exit status after Ctrl-C, as in shells: 128 + SIGINT."""
PROGRESS_STRIDE = 20
"""Items between two updates of the progress bar."""
SLOW_SECONDS = 2.0
"""Delay of the message of `print_if_slow`, seconds."""

Item = TypeVar("Item")


def print_message(text: str) -> None:
    """Print `text` on stderr as one line that starts with `wclm: `. A terminal that is gone is no error.

    It is written to `sys.stderr` itself, which a live table or progress bar replaces to print lines above itself;
    `typer.echo` would write past it, and the next update would erase the line.
    """
    with suppress(OSError):
        sys.stderr.write(f"wclm: {printable(' '.join(text.split()))}\n")
        sys.stderr.flush()


def printable(text: str) -> str:
    """Return `text` without control characters, with which names in a foreign file could operate the terminal."""
    return "".join(character if character.isprintable() else "\N{REPLACEMENT CHARACTER}" for character in text)


@contextmanager
def print_if_slow(text: str) -> Iterator[None]:
    """Print `text` on stderr if the block takes longer than SLOW_SECONDS."""
    timer = Timer(SLOW_SECONDS, print_message, [text])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def progress(items: Iterable[Item], total: int, label: str) -> Iterator[Item]:
    """Yield `items`, with a progress bar on stderr if that is a terminal; `total` is 0 if unknown."""
    if not sys.stderr.isatty():
        yield from items
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(label, total=total or None)
        for count, item in enumerate(items):
            if count % PROGRESS_STRIDE == 0:
                bar.update(task, completed=count)
            yield item
