"""Process that reads damaged inputs of one kind, and reports the failures as lines of JSON."""

from __future__ import annotations

import json
import mmap
import random
import resource
import struct
import sys
import tempfile
import traceback
import warnings
from contextlib import suppress
from pathlib import Path

from drivers.errors import SlamError
from slam.warmup import warm_up

from .kinds import Kind, make_kinds

MAX_MEMORY = 500
"""Megabytes that reading one input may need."""
ADDRESS_SPACE = 4_000_000_000
"""Bytes that the process may have more than at its beginning, so that it does not fill the computer's memory."""
POSITION = struct.Struct("<BIQ")
"""State of the process, number of the kind, and number of the input."""
STARTING, READING, DONE = range(3)
OUT_OF_BOUNDS = "index is out of bounds"
"""Text of the error of a compiled function that checks the bounds of arrays."""


def failure_of(kind: Kind, intact: bytes, number: int) -> str:
    """Read the damaged input with this number; return what is wrong with the program then, empty if nothing is."""
    kind.file.write_bytes(kind.mutate(intact, random.Random(number)))
    try:
        kind.read(kind.path)
    except SlamError as error:
        message = str(error)
        if not message.strip() or len(message.splitlines()) != 1 or len(message) > 2000:
            return f"the message is not one line: {message[:500]!r}"
        if str(error.__cause__) == OUT_OF_BOUNDS:
            return f"a compiled function reads beyond an array, then: {message}"
    except Exception:
        return traceback.format_exc()
    finally:
        kind.file.write_bytes(intact)
    return ""


def peak_memory() -> int:
    """Return the largest memory (megabytes) that the process had since the last call."""
    (line,) = (line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM"))
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")  # begins a new measurement
    return int(line.split()[1]) // 1024


def main(names: list[str], begin: int, first: int, end: int, step: int, progress: Path) -> None:
    """Read the inputs range(begin, end, step) of the first kind, and range(first, end, step) of the others.

    Writes the number of the kind and that of the input into the file `progress` before, and at the end.
    """
    warnings.simplefilter("ignore")
    warm_up()
    with tempfile.TemporaryDirectory() as folder, progress.open("r+b") as file:
        current = mmap.mmap(file.fileno(), POSITION.size)
        kinds = make_kinds(Path(folder))
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        for index, name in enumerate(names):
            kind = kinds[name]
            intact = kind.file.read_bytes()
            kind.read(kind.path)
            resource.setrlimit(resource.RLIMIT_AS, (used + ADDRESS_SPACE, resource.RLIM_INFINITY))
            usual = peak_memory()
            for number in range(begin if index == 0 else first, end, step):
                current[:] = POSITION.pack(READING, index, number)
                failure = failure_of(kind, intact, number)
                if (memory := peak_memory() - usual) > MAX_MEMORY:
                    failure = failure or f"needs {memory} MB"
                if failure:
                    print(json.dumps({"kind": name, "number": number, "failure": failure}), flush=True)
        current[:] = POSITION.pack(DONE, 0, 0)


if __name__ == "__main__":
    main(sys.argv[1].split(","), *map(int, sys.argv[2:6]), Path(sys.argv[6]))
