"""Say in words how often a robot returned to known places, and what became of its loops."""

from __future__ import annotations

from typing import Any

from drivers.elapsed import elapsed

from ...formatting import counted, length
from ...loop_closure.loop_status import LoopStatus


def returns_text(slam: dict[str, Any]) -> str:
    """Return how often the robot returned and how well the map fitted there; empty if it did not, or if it is unknown.

    slam  part `slam` of a run's summary
    """
    returns = slam.get("returns") or {}
    if not returns.get("count"):
        return ""
    count = returns["count"]
    return (
        f"returned {'once' if count == 1 else f'{count} times'} to a known place; the map was correct there to "
        f"{length(returns['position_rms'])} (RMS of {counted(returns['looks'], 'comparison')}), "
        f"at worst {length(returns['position_max'])}"
    )


def loops_text(slam: dict[str, Any]) -> str:
    """Return how many loops were closed, retracted, forbidden and rejected; empty if there were none."""
    counts = slam.get("loops") or {}
    rows = slam.get("loop_decisions") or []
    parts = []
    if closed := counts.get(LoopStatus.ACCEPTED, 0):
        shift = max((row["shift"] for row in rows if row["status"] == LoopStatus.ACCEPTED), default=0.0)
        parts.append(
            f"{counted(closed, 'loop')} closed" + (f", which moved the robot by up to {length(shift)}" if shift else "")
        )
    if retracted := counts.get(LoopStatus.RETRACTED, 0):
        parts.append(f"{retracted} of them retracted, as later scans contradicted it")
    if forbidden := sum(row["status"] == LoopStatus.FORBIDDEN for row in rows):
        parts.append(f"{forbidden} forbidden by hand")
    if rejected := counts.get(LoopStatus.REJECTED, 0):
        parts.append(f"{rejected} rejected as unsafe")
    return "; ".join(parts)


def no_loops_text(slam: dict[str, Any]) -> str:
    """Return why no loop was closed or rejected, as far as the summary of the run states it, as sentences."""
    if slam.get("extends_map") is False:
        return "The robot was only localised in the map, which stayed as it is: no loops were searched for."
    returns = slam.get("returns")
    if returns is None:
        return "No loop was closed or rejected."
    if returns.get("count"):
        return "No loop had to be closed: the map was correct wherever the robot returned to a known place."
    return (
        "No loop was closed or rejected, as no return to a known place was found. "
        "That needs some metres of driving through a place that was mapped before."
    )


def nearest_rejection(slam: dict[str, Any], start: float) -> str:
    """Return time and reason of the rejected loop that came nearest to being closed; empty if that is not known.

    start  stamp (seconds) from which times are counted
    """
    rejected = [row for row in slam.get("loop_decisions") or [] if row["status"] == LoopStatus.REJECTED]
    rows = by_margin([row for row in rejected if row.get("margin") is not None])  # sessions do not contain it
    return f"at {elapsed(rows[0]['stamp'] - start)}: {rows[0]['reason']}" if rows else ""


def by_margin(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows of loop decisions, those that came nearest to being closed first."""
    return sorted(rows, key=lambda row: -(row.get("margin") or 0.0))
