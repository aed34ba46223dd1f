"""Memory of long runs."""

import subprocess
import sys

GAPS = """
import ctypes, sys
from pathlib import Path
from slam.cli.memory import return_large_blocks

libc = ctypes.CDLL(None)
libc.malloc.restype, libc.malloc.argtypes, libc.free.argtypes = ctypes.c_void_p, [ctypes.c_size_t], [ctypes.c_void_p]

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096

def filled(size):
    block = libc.malloc(size)
    ctypes.memset(block, 1, size)
    return block

return_large_blocks()
libc.free(filled(20_000_000))
before = resident()
blocks = [(filled(8_000_000), filled(500_000)) for _ in range(10)]
for large, _ in blocks:
    libc.free(large)
sys.exit(resident() - before > 10_000_000)
"""


def test_large_blocks_are_returned_when_they_are_freed() -> None:
    assert subprocess.run([sys.executable, "-c", GAPS], check=False).returncode == 0
