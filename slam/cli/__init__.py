"""The command line `wclm`.

app, commands                                  the commands, and the application that holds them
slam_run, run_input, run_summary, compilation  one run of SLAM, which `run`, `live`, `demo` and `batch` share
acquisition_loop, device_monitor, device_options  devices
console, options, output_files, viewer         messages, options, files, the Rerun viewer
"""

from __future__ import annotations

import signal
import sys

from .console import EXIT_USER_ERROR, print_message
from .import_check import find_import_error

EXIT_TERMINATED = 128 + signal.SIGTERM


def main() -> None:
    """Run the command line. SIGTERM ends a command with the same cleanup as Ctrl-C."""
    if error := find_import_error():
        print_message(error)
        sys.exit(EXIT_USER_ERROR)
    from .app import app

    signal.signal(signal.SIGTERM, lambda *_: sys.exit(EXIT_TERMINATED))
    app(prog_name="wclm")


__all__ = ["main"]
