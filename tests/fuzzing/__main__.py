"""Read damaged inputs of all kinds: `python -m tests.fuzzing --help`.

No input may cause an error other than SlamError with a text of one line, take longer than MAX_SECONDS, need more than
`worker.MAX_MEMORY`, read beyond an array, or end the process. Input k of a kind is always the same: `--first k
--inputs 1` repeats it.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from .kinds import make_kinds
from .worker import DONE, POSITION, READING, STARTING

MAX_SECONDS = 5.0
"""Processor time of an input, so that a busy computer makes no difference."""
MAX_WAIT = 300.0
"""Seconds that an input may take in all, and a process before its first one, with the compilation after a change."""
CHECKED = {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(Path(__file__).parents[2] / "build" / "bounds_checked")}
"""Environment in which compiled functions check the bounds of arrays: else damage may read any memory, mostly without
an error.
"""


def failures(names: list[str], first: int, end: int, step: int) -> Iterator[tuple[str, int, str]]:
    """Yield kind, number and failure of the inputs range(first, end, step) of some kinds that fail."""
    begin = first
    while names:
        with tempfile.TemporaryDirectory() as folder:
            progress, output = Path(folder, "progress"), Path(folder, "output")
            progress.write_bytes(bytes(POSITION.size))
            arguments = [",".join(names), *map(str, (begin, first, end, step, progress))]
            with output.open("w") as lines:
                command = [sys.executable, "-m", f"{__package__}.worker", *arguments]
                process = subprocess.Popen(command, stdout=lines, env=os.environ | CHECKED)
                problem = watch(process, progress)
            state, kind, number = POSITION.unpack(progress.read_bytes())
            found = [json.loads(line) for line in output.read_text().splitlines()]
        yield from ((row["kind"], row["number"], row["failure"]) for row in found)
        if state == DONE:
            return
        if state == STARTING:
            raise RuntimeError(f"the worker {problem} before the first input")
        yield names[kind], number, problem
        names, begin = names[kind:], number + step


def watch(process: subprocess.Popen[bytes], progress: Path) -> str:
    """Wait for the end of a worker; end it if it makes no progress. Return what is wrong, empty if nothing is."""
    last, since, used = b"", time.monotonic(), cpu_seconds(process.pid)
    while process.poll() is None:
        time.sleep(0.1)
        if (now := progress.read_bytes()) != last:
            last, since, used = now, time.monotonic(), cpu_seconds(process.pid)
        waited, worked = time.monotonic() - since, cpu_seconds(process.pid) - used
        if waited > MAX_WAIT or (last[:1] == bytes([READING]) and worked > MAX_SECONDS):
            process.kill()
            process.wait()
            return f"takes longer than {worked:.0f} s of processor time, {waited:.0f} s in all"
    return f"ends the process with status {process.returncode}" if process.returncode else ""


def cpu_seconds(process: int) -> float:
    """Return the processor time of a process, 0 if it has ended."""
    try:
        user, system = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[11:13]
    except OSError:
        return 0.0
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    parser = argparse.ArgumentParser(description="Read damaged inputs of all kinds; the exit status is 1 if one fails.")
    parser.add_argument("kinds", nargs="*", help="kinds or beginnings of their names; all by default")
    parser.add_argument("--inputs", type=int, default=1000, help="inputs per kind (default: %(default)s)")
    parser.add_argument("--first", type=int, default=0, help="number of the first input (default: %(default)s)")
    parser.add_argument("--shard", default="1/1", help="K/N: only every Nth input, beginning with the Kth")
    parser.add_argument("--list", action="store_true", help="print the kinds")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        names = [name for name in make_kinds(Path(folder)) if name.startswith(tuple(arguments.kinds or [""]))]
    if arguments.list:
        print("\n".join(names))
        return
    shard, shards = map(int, arguments.shard.split("/"))
    first, end, count = arguments.first + shard - 1, arguments.first + arguments.inputs, 0
    for name, number, failure in failures(names, first, end, shards):
        count += 1
        print(f"{name} {number}: {failure}", flush=True)
    print(f"{count} of {len(names) * len(range(first, end, shards))} inputs of {len(names)} kinds fail")
    sys.exit(1 if count else 0)


if __name__ == "__main__":
    main()
