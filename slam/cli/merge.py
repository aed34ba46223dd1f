"""`wclm merge`: one map of several sessions."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from drivers.messages import Message, SourceReport

from ..events import Sink
from .console import OutOption, OverwriteOption, PlotOption, ReviewOption, say_if_slow

if TYPE_CHECKING:
    from ..joining import Joined
    from .session import Outcome, Tally

FEWEST = 2


def merge(
    sessions: Annotated[
        list[Path], typer.Argument(metavar="SESSION SESSION...", help="Directories that runs in one building left.")
    ],
    out: OutOption,
    overwrite: OverwriteOption = False,
    review: ReviewOption = True,
    plot: PlotOption = False,
) -> None:
    """Make one map of several sessions, in the frame of the first, without being told where they lie in each other.

    Places of each are looked for in the others; only where several of them agree are the sessions joined, and everything
    is looked at again. Sessions that do not recognise each other are refused.

    Example: [bold]wclm merge maps/monday maps/tuesday --out maps/both[/bold]
    """
    from .report import lines_for_people

    if len(sessions) < FEWEST:
        raise typer.BadParameter("name two sessions or more", param_hint="SESSION SESSION...")
    outcome = _merge(sessions, out, overwrite=overwrite, review=review, picture=plot)
    typer.echo("\n".join([*lines_for_people(outcome, out), *_joints(outcome.summary)]))
