"""Write the panel below the map that composes a command for corrections."""

from __future__ import annotations

from ...io.output_dir import SESSION
from ...io.run_results import RunResults


def corrections_panel(results: RunResults) -> str:
    """Return the panel that offers corrections of what is chosen on the map; empty without a session to correct."""
    if not (results.path / SESSION).is_dir():
        return ""
    start = float(results.trajectory.stamps[0])
    return (
        '<div id="correct"><div class="offers"></div>'
        f'<div class="places" data-start="{start!r}">'
        "<p>If a loop was missed, move the time to one visit of the place, mark it, and move the time to the other.</p>"
        '<button type="button">Mark this place</button><button type="button" hidden></button></div>'
        '<div class="command" aria-live="polite" hidden><p>Run this command to correct the map; '
        '<code>--undo</code> takes the last correction back.</p><pre><code class="composed"></code></pre>'
        '<button type="button">Copy</button><button type="button">Clear</button></div></div>'
    )
