"""Build hook of the wheel: with WCLM_COMPILED=1 in the environment it contains compiled functions (`make wheel`).

They are compiled for a portable level of this computer's architecture, with the numba of the environment in which the
build runs, so that must be the project's own and no isolated one. Without the variable the wheel is pure Python.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

ROOT = Path(__file__).parent

X86_64_V3 = (
    *("avx", "avx2", "bmi", "bmi2", "cx16", "f16c", "fma", "lzcnt", "movbe"),
    *("popcnt", "sahf", "sse3", "sse4.1", "sse4.2", "ssse3", "xsave"),
)
"""Features of the level x86-64-v3 beyond the first one, in LLVM's terms; processors of PCs have them since Haswell
(2013) and Excavator (2015). Origin: definition, psABI of x86-64."""

LEVELS: dict[str, tuple[str, tuple[str, ...]]] = {"x86_64": ("x86-64-v3", X86_64_V3), "aarch64": ("generic", ())}
"""Processor and features, in LLVM's terms, by architecture; NEON belongs to aarch64 itself."""

GLIBC = "2_28"
"""Oldest C library of the wheel's tag. Origin: the tags of numba's and llvmlite's wheels."""

PROGRAM = """
import sys
from pathlib import Path
from kernel_cache.wheel import write_wheel_cache
from slam.ros.outputs import warm_up as warm_up_node
from slam.warmup import compile_preprocessing, warm_up

warm_up()
compile_preprocessing()
warm_up_node()
print(write_wheel_cache(Path(sys.argv[1]), sys.argv[2:]), "compiled functions")
"""


class CompiledFunctions(BuildHookInterface[Any]):
    """Adds compiled functions to the wheel, with a tag of this platform and the version of numba that they need."""

    PLUGIN_NAME = "custom"

    def initialize(self, version_of_wheel: str, build_data: dict[str, Any]) -> None:
        """Compile, unless the wheel is to be pure Python or an editable one."""
        if not os.environ.get("WCLM_COMPILED") or version_of_wheel == "editable":
            return
        self._folder = tempfile.TemporaryDirectory()
        machine = platform.machine()
        compile_to(Path(self._folder.name) / "compiled", machine)
        python = f"cp{sys.version_info.major}{sys.version_info.minor}"
        build_data["pure_python"] = False
        build_data["tag"] = f"{python}-{python}-manylinux_{GLIBC}_{machine}"
        build_data["force_include"][f"{self._folder.name}/compiled"] = "kernel_cache/compiled"
        build_data["dependencies"].append(f"numba=={version('numba')}")

    def finalize(self, version_of_wheel: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Delete what was compiled."""
        if hasattr(self, "_folder"):
            self._folder.cleanup()


def compile_to(folder: Path, machine: str) -> None:
    """Compile all functions that runs call for the portable level of an architecture, which must be this computer's."""
    name, features = LEVELS[machine]
    with tempfile.TemporaryDirectory() as cache:
        target = {"NUMBA_CPU_NAME": name, "NUMBA_CPU_FEATURES": ",".join(f"+{feature}" for feature in features)}
        environment = {**os.environ, **target, "NUMBA_CACHE_DIR": cache, "PYTHONPATH": str(ROOT)}
        subprocess.run([sys.executable, "-c", PROGRAM, str(folder), *features], env=environment, check=True)
