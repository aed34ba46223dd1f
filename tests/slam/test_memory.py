"""Memory that runs have freed."""

import subprocess
import sys

import pytest

BLOCKS = """
import ctypes, sys
from pathlib import Path
from slam.memory import LARGE_LIVE_BLOCK, return_code_of_imports, return_freed_memory, return_large_blocks

libc = ctypes.CDLL(None)
libc.malloc.restype, libc.malloc.argtypes, libc.free.argtypes = ctypes.c_void_p, [ctypes.c_size_t], [ctypes.c_void_p]

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096

def filled(size):
    block = libc.malloc(size)
    ctypes.memset(block, 1, size)
    return block
"""
LARGE = """
return_large_blocks(LARGE_LIVE_BLOCK)
libc.free(filled(20_000_000))
before = resident()
blocks = [(filled(8_000_000), filled(500_000)) for _ in range(10)]
for large, _ in blocks:
    libc.free(large)
sys.exit(resident() - before > 10_000_000)
"""
SMALL = """
return_freed_memory()
before = resident()
blocks = [filled(10_000) for _ in range(5_000)]
for block in blocks[:-1]:
    libc.free(block)
kept = resident() - before
return_freed_memory()
sys.exit(not (kept > 40_000_000 and resident() - before < 10_000_000))
"""
CODE = """
import gtsam
before = resident()
return_code_of_imports()
returned = before - resident()
sys.exit(not (returned > 10_000_000 and gtsam.Pose2(1.0, 2.0, 0.0).inverse().x() == -1.0))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="memory is returned on Linux only")
@pytest.mark.parametrize(
    "code", [LARGE, SMALL, CODE], ids=["large blocks when freed", "all that is free at a call", "code of imports"]
)
def test_freed_memory_is_returned(code: str) -> None:
    assert subprocess.run([sys.executable, "-c", BLOCKS + code], check=False).returncode == 0
