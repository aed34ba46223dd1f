"""The command line `wclm`.

app, commands                                  the commands, and the application that holds them
setup_from_options, slam_run, run_input, run_summary, compilation
                                               one run of SLAM, which `run`, `live`, `demo` and `batch` share
acquisition_loop, device_monitor, device_options  devices
console, signals, options, output_files, viewer  messages, signals, options, files, the Rerun viewer
"""

from __future__ import annotations

import gc
import os
import sys

from ..memory import return_large_blocks
from .signals import exit_at_once, exit_on_signals

COLLECTION_THRESHOLD = 250_000
"""New objects after which Python looks for garbage, instead of 700: imports create some 200 000 that all stay."""


def main() -> None:
    """Run the command line. SIGTERM and SIGHUP end a command with the same cleanup as Ctrl-C.

    While modules are imported there is nothing to clean up: Ctrl-C then ends the process at once, without a word.
    """
    exit_at_once()
    return_large_blocks()  # before imports raise the size from which glibc does
    gc.set_threshold(COLLECTION_THRESHOLD)
    os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")  # reuses what a run has freed
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # matrices are small: other threads would only wait, busily
    from typer.main import get_command

    from .console import EXIT_USER_ERROR, print_message
    from .import_check import find_import_error

    if error := find_import_error():
        print_message(error)
        sys.exit(EXIT_USER_ERROR)
    from .app import app, leave_out_others
    from .compilation import announce_compilation

    announce_compilation()
    leave_out_others(sys.argv[1:])
    command = get_command(app)
    exit_on_signals()
    command(prog_name="wclm")


__all__ = ["main"]
