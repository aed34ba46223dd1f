"""Say in words what a review log does not contain."""

from __future__ import annotations

from collections.abc import Mapping

from ..formatting import counted

LOSSES = {
    "thinned": "left out or without points, as logging was slow",
    "lost": "left out, as logging stalled",
    "failed": "that could not be logged",
    "unwritten": "left out, as the disk was nearly full",
}


def log_losses_text(left_out: Mapping[str, int]) -> str:
    """Return what is missing in a log; empty if it is complete.

    left_out  numbers of events that are not logged completely, by reason, as of `ReviewLog.left_out`
    """
    losses = [f"{counted(count, 'event')} {LOSSES.get(reason, reason)}" for reason, count in left_out.items() if count]
    return f"incomplete: {'; '.join(losses)}" if losses else ""
