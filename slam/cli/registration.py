"""Adding functions as commands to a typer application."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import typer


def add_command(app: typer.Typer, name: str, function: Callable[..., Any], panel: str | None = None) -> None:
    """Add a command whose help is the docstring of `function`, in a panel of the list of commands."""
    app.command(name, help=help_text(function), rich_help_panel=panel)(function)


def help_text(function: Callable[..., Any]) -> str:
    """Return the docstring of a function with each paragraph on one line.

    The help would keep the line breaks of the source otherwise, in terminals of any width.
    """
    paragraphs = (inspect.getdoc(function) or "").split("\n\n")
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)
