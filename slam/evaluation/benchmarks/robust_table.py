"""Table of the results of `wclm bench robust`, in Markdown."""

from __future__ import annotations

import math

from .robust_scores import RobustResult

TABLE_HEAD = (
    "| drive | reference | distance, m | error, m | max, m | entropy | conflict | placed | LOST | closures | suspects "
    "| CPU, s |",
    "|---" * 12 + "|",
)


def table_row(result: RobustResult) -> str:
    """Return the line of a Markdown table: values of SLAM and, after a stroke, of raw odometry.

    Those of SLAM that are worse than odometry's by the factor WORSE are bold.
    """
    if result.failed:
        return f"| {result.name} | no map: {result.failed} " + "|" * 11
    shares = f"{100 * result.placed:.0f} % | {100 * result.lost:.0f} %"
    return (
        f"| {result.name} | {result.reference or '-'} | {result.travelled:.0f} | {_cell(result, 'error')} "
        f"| {_number(result.slam.max_error)} | {_cell(result, 'entropy')} | {_cell(result, 'conflict')} | {shares} "
        f"| {result.closures} | {len(result.suspects)} | {result.cpu:.1f} |"
    )


def _cell(row: RobustResult, name: str) -> str:
    slam, odometry = getattr(row.slam, name), getattr(row.odometry, name)
    if math.isnan(slam):
        return "-"
    text = f"**{_number(slam)}**" if name in row.worse else _number(slam)
    return f"{text} / {_number(odometry)}"


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.3f}"
