"""`wclm bench`: the benchmarks, one module per command."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import typer

from ...registration import add_command
from .consistency import bench_consistency
from .diff import bench_diff
from .false_closures import bench_false_closures
from .features import bench_features
from .gate import bench_gate
from .laps import bench_laps
from .lookalike import bench_lookalike
from .measure import bench_measure
from .paper import bench_paper
from .plan import bench_plan
from .regular import bench_regular
from .relocalisation import bench_relocalisation
from .residuals import bench_residuals
from .robust import bench_robust
from .slam import bench_slam

bench = typer.Typer(no_args_is_help=True, help="Run benchmarks of accuracy, consistency, robustness and speed.")
COMMANDS: dict[str, Callable[..., Any]] = {
    "slam": bench_slam,
    "features": bench_features,
    "consistency": bench_consistency,
    "measure": bench_measure,
    "regular": bench_regular,
    "diff": bench_diff,
    "plan": bench_plan,
    "laps": bench_laps,
    "residuals": bench_residuals,
    "robust": bench_robust,
    "relocalisation": bench_relocalisation,
    "lookalike": bench_lookalike,
    "false-closures": bench_false_closures,
    "paper": bench_paper,
    "gate": bench_gate,
}

for name, function in COMMANDS.items():
    add_command(bench, name, function)

__all__ = ["bench"]
