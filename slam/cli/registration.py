"""Adding functions as commands to a typer application."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from typing import Any

import typer

NO_MARKUP = re.compile(r"\[(?!/?bold\])")
"""A bracket in a docstring that does not begin one of the tags used there, `[bold]` and `[/bold]`."""


def add_command(app: typer.Typer, name: str, function: Callable[..., Any], panel: str | None = None) -> None:
    """Add a command whose help is the docstring of `function`, in a panel of the list of commands."""
    app.command(name, help=help_text(function), rich_help_panel=panel)(function)


def help_text(function: Callable[..., Any]) -> str:
    """Return the docstring of a function with each paragraph on one line, and brackets that are no markup escaped.

    The help would keep the line breaks of the source otherwise, in terminals of any width, and leave out `[ros2]`.
    """
    paragraphs = (inspect.getdoc(function) or "").split("\n\n")
    return NO_MARKUP.sub(r"\\[", "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs))
