"""The application `wclm`: its commands, in the order of the help, and the handling of their errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup

from drivers.errors import SlamError

from .commands.batch import batch
from .commands.bench import bench
from .commands.calibrate import calibrate
from .commands.correct import correct
from .commands.demo import demo
from .commands.devices import devices
from .commands.diff import diff
from .commands.emulate import emulate
from .commands.evaluate import evaluate
from .commands.features import features
from .commands.info import info
from .commands.live import live
from .commands.map import export_map
from .commands.measure import measure
from .commands.merge import merge
from .commands.mode import mode
from .commands.optimize import optimize
from .commands.record import record
from .commands.recover import recover
from .commands.replay import replay
from .commands.report import report
from .commands.review import review
from .commands.ros import ros
from .commands.run import run
from .commands.save import save
from .commands.simulate import simulate
from .console import EXIT_INTERRUPTED, EXIT_USER_ERROR, print_message
from .registration import add_command, help_text

UsageError: Any = typer.BadParameter.__mro__[1]
"""Class of errors in the arguments; typer exports only its subclasses."""


class _Commands(TyperGroup):
    """Commands that report mistakes as one line and an exit status; other exceptions are bugs and are raised."""

    def parse_args(self, ctx: Any, args: list[str]) -> Any:
        try:
            return super().parse_args(ctx, args)
        except UsageError as error:
            _report_usage(error, ctx.command_path)

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except UsageError as error:
            called = f"{ctx.command_path} {ctx.invoked_subcommand}"  # the parser of options does not know the command
            _report_usage(error, error.ctx.command_path if error.ctx else called)
        except SlamError as error:
            print_message(str(error))
            raise typer.Exit(EXIT_USER_ERROR) from error
        except KeyboardInterrupt as error:
            print_message("interrupted; nothing was written")
            raise typer.Exit(EXIT_INTERRUPTED) from error


def _report_usage(error: Any, command: str) -> NoReturn:
    """Report a mistake in the arguments of a command as one line, with where its help is."""
    text = error.format_message()
    if not text:  # a group of commands without arguments, which has printed its help
        raise error
    text = text.replace("Value error, ", "")  # a prefix of pydantic, which says nothing
    separator = "" if text.endswith("?") else ";"
    print_message(f"{text.rstrip('.')}{separator} see {command} --help")
    raise typer.Exit(EXIT_USER_ERROR) from error


app = typer.Typer(
    cls=_Commands,
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_versions(requested: bool) -> None:
    if requested:
        from ..io.host import versions

        typer.echo(", ".join(f"{name} {version}" for name, version in versions().items()))
        raise typer.Exit


def wclm(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=_print_versions,
            is_eager=True,
            help="Print versions and exit.",
        ),
    ] = False,
) -> None:
    """Map buildings with a 2-D lidar and wheel odometry: walls and corners with covariances.

    To start, [bold]wclm demo[/bold] maps a simulated museum. A session is the output directory of a run: the map, and
    what is needed to continue, refine or correct it.
    """


app.callback(help=help_text(wclm))(wclm)

COMMANDS: dict[str, dict[str, Callable[..., Any]]] = {
    "Mapping": {
        "demo": demo,
        "run": run,
        "live": live,
        "ros": ros,
        "save": save,
        "mode": mode,
        "recover": recover,
        "batch": batch,
    },
    "Sessions": {
        "optimize": optimize,
        "correct": correct,
        "merge": merge,
        "map": export_map,
        "measure": measure,
        "diff": diff,
        "report": report,
        "review": review,
    },
    "Recordings and devices": {
        "info": info,
        "simulate": simulate,
        "emulate": emulate,
        "devices": devices,
        "record": record,
        "replay": replay,
        "calibrate": calibrate,
    },
    "Evaluation": {"eval": evaluate, "features": features},
}
"""Commands by name, in the panels of the help."""

for panel, commands in COMMANDS.items():
    for name, function in commands.items():
        add_command(app, name, function, panel)
app.add_typer(bench, name="bench", rich_help_panel="Evaluation")


def leave_out_others(arguments: Sequence[str]) -> None:
    """Leave out all commands but the one that is called: to set up the parameters of all takes longer than to parse.

    All are kept if the first of the `arguments` is not the name of a command, for the help and for suggestions.
    """
    called = arguments[0] if arguments else None
    commands = [command for command in app.registered_commands if command.name == called]
    groups = [group for group in app.registered_groups if group.name == called]
    if commands or groups:
        app.registered_commands, app.registered_groups = commands, groups
