"""Map recordings with all estimated constants changed at random: `python -m tests.sensitivity --help`.

The origin of most constants is an estimate ("chosen", "measured" or "tuned", see docs/contributing.md). If results
depended on their exact values, these would fit the recordings at hand, and other recordings would fail. So each is
multiplied by a random factor, all at the same time, in a copy of the packages, and `wclm bench robust` runs with it.
"""

from __future__ import annotations

import argparse
import math
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from .constants import change_constants

ROOT = Path(__file__).parents[2]
PACKAGES = ("slam", "features", "drivers", "kernel_cache")
CHANGED = (
    *(f"slam/{name}" for name in ("checks", "estimation", "geometry", "graph", "localisation", "loop_closure")),
    *(f"slam/{name}" for name in ("mapping", "matching", "odometry", "preprocessing", "recognition")),
    "features",
)
"""Packages of the estimator."""
KEPT = "features/benchmark"
COMMAND = "import sys; from slam.cli import main; sys.exit(main())"


def copy_changed(folder: Path, seed: int, factor: float) -> int:
    """Copy the packages to a folder with changed constants, and return the number of the changed ones."""
    random, count = np.random.default_rng(seed), 0
    for package in PACKAGES:
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    for package in CHANGED:
        for file in sorted((folder / package).rglob("*.py")):
            if not file.is_relative_to(folder / KEPT):
                text, changed = change_constants(
                    file.read_text(encoding="utf-8"), lambda: math.exp(math.log(factor) * random.uniform(-1.0, 1.0))
                )
                count += changed
                if changed:
                    file.write_text(text, encoding="utf-8")
    return count


def main() -> int:
    """Run the benchmark with changed constants, and return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m tests.sensitivity", description=__doc__)
    parser.add_argument("arguments", nargs="*", help="arguments of `wclm bench robust`, after --")
    parser.add_argument("--seed", type=int, default=1, help="of the factors; default 1")
    parser.add_argument("--factor", type=float, default=1.2, help="largest factor, above 1 and at most 2; default 1.2")
    options = parser.parse_args()
    if not 1.0 < options.factor <= 2.0:
        parser.error("--factor: above 1 and at most 2")
    with tempfile.TemporaryDirectory() as folder:
        count = copy_changed(Path(folder), options.seed, options.factor)
        print(f"{count} constants multiplied by {1.0 / options.factor:.2f} to {options.factor:.2f}", flush=True)
        variables = {**os.environ, "PYTHONPATH": folder, "NUMBA_CACHE_DIR": str(Path(folder, "cache"))}
        command = [sys.executable, "-c", COMMAND, "bench", "robust", *options.arguments]
        return subprocess.run(command, env=variables, cwd=folder).returncode


if __name__ == "__main__":
    sys.exit(main())
