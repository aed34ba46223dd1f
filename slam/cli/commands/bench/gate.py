"""`wclm bench gate`: regression check of accuracy and time."""

from __future__ import annotations

import typer

from ...compilation import compile_all
from ...console import print_message
from .output import heading

EXIT_REGRESSION = 1
"""Exit status if a figure is worse than its limit."""


def bench_gate() -> None:
    """Check accuracy and time against limits on a small part of the benchmarks; exit status 1 if one is exceeded.

    Example: [bold]wclm bench gate[/bold]
    """
    from ....evaluation.benchmarks.regression_checks import format_checks, run_checks

    compile_all()
    typer.echo("\n".join(heading(0)))
    found = []
    for check in run_checks():
        found.append(check)
        typer.echo("\n".join(format_checks([check])))
    if failed := [check.name for check in found if not check.passed]:
        print_message("regression: " + ", ".join(failed))
        raise typer.Exit(EXIT_REGRESSION)
