"""Adding functions as commands to a typer application."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import typer


def add_command(app: typer.Typer, name: str, function: Callable[..., Any], panel: str | None = None) -> None:
    """Add a command whose help is the docstring of `function`, in a panel of the list of commands.

    Each paragraph is joined to one line, because the help would keep the line breaks of the source.
    """
    paragraphs = (inspect.getdoc(function) or "").split("\n\n")
    text = "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)
    app.command(name, help=text, rich_help_panel=panel)(function)
