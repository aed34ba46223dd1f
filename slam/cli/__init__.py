"""The command line `wclm`: one file for each command, and what they share in `console`, `session` and `report`.

Commands import what they need when they are called, so that `wclm --help` answers at once.
"""

from __future__ import annotations

import signal
import sys
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from drivers.errors import SlamError

from .commands.batch import batch
from .commands.bench import bench
from .commands.bench import features as _features
from .commands.bench import loops as _loops
from .commands.bench import slam as _slam
from .commands.calibrate import calibrate
from .commands.demo import demo
from .commands.devices import devices
from .commands.emulate import emulate
from .commands.evaluate import evaluate
from .commands.features import features
from .commands.info import info
from .commands.live import live
from .commands.map import export_map
from .commands.merge import merge
from .commands.optimize import optimize
from .commands.record import record
from .commands.replay import replay
from .commands.report import report
from .commands.review import review
from .commands.run import run
from .commands.simulate import simulate
from .console import EXIT_INTERRUPTED, EXIT_USER_ERROR, print_message

EXIT_TERMINATED = 128 + signal.SIGTERM


class _Commands(TyperGroup):
    """Commands whose errors are one line and an exit status; what is not a SlamError is a bug and shows itself."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except SlamError as error:
            print_message(str(error))
            raise typer.Exit(EXIT_USER_ERROR) from error
        except KeyboardInterrupt as error:
            print_message("interrupted; nothing was written")
            raise typer.Exit(EXIT_INTERRUPTED) from error


app = typer.Typer(
    cls=_Commands,
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        from ..io.host import versions

        typer.echo(", ".join(f"{name} {version}" for name, version in versions().items()))
        raise typer.Exit


@app.callback()
def wclm(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print versions and exit.")
    ] = False,
) -> None:
    """Maps buildings from a 2-D lidar and wheel odometry: walls and corners, with honest uncertainties.

    New here? [bold]wclm demo[/bold] drives a simulated robot through an office and maps it.
    """


app.command()(demo)
app.command()(run)
app.command()(live)
app.command()(batch)
app.command()(optimize)
app.command()(merge)
app.command("map")(export_map)
app.command()(report)
app.command()(review)
app.command()(info)
app.command()(simulate)
app.command()(emulate)
app.command()(devices)
app.command()(record)
app.command()(replay)
app.command()(calibrate)
app.command("eval")(evaluate)
app.command()(features)
app.add_typer(bench, name="bench")


def main() -> None:
    """Entry point of `wclm`. Being told to terminate cleans up just as Ctrl-C does."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(EXIT_TERMINATED))
    app(prog_name="wclm")


__all__ = ["app", "main"]
