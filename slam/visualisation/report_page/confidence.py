"""Write the section on where the map is poorly known, and the switch of its layer in the map."""

from __future__ import annotations

from html import escape

import numpy as np

from ...checks.weak_places import MAX_SIGMA
from ...formatting import counted, percent
from ...io.exports.confidence import CLASS_LIMITS, wall_stretches, weak_places
from ...io.run_results import RunResults
from .sections import item_list, place_button

MAX_LISTED = 8
SWITCH = (
    '<label class="layer"><input type="checkbox">confidence map: how well each wall is known, and which drive would '
    "improve the map</label>\n"
)
NOTE = "Standard deviations are relative to the origin of the map, where the drive started; of walls, across them."


def confidence_section(results: RunResults, extent: float) -> str:
    """Return the share of the walls that is well known, and the weak places; empty if covariances are unknown.

    extent  larger side of the drawing, metres
    """
    stretches = wall_stretches(results.walls)
    if not stretches or results.keyframes is None:
        return ""
    lengths = np.array([float(np.hypot(*np.diff(one.points, axis=0)[0])) for one in stretches])
    levels = np.array([one.level for one in stretches])
    known = [
        f"{percent(float(lengths[levels <= k].sum() / lengths.sum()))} to {100 * limit:g} cm"
        for k, limit in enumerate(CLASS_LIMITS)
        if limit <= MAX_SIGMA or (levels > k).any()
    ]
    shares = ", ".join([known[0].replace("to", "of the length of the walls is known to"), *known[1:]])
    places = weak_places(results)
    start = float(results.trajectory.stamps[0])
    items = [
        f'<li class="minor">{place_button(place.position, place.stamp - start, extent)}'
        f"<span><b>{escape(place.text)}.</b> {escape(place.drive)}.</span></li>"
        for place in places[:MAX_LISTED]
    ]
    if (more := len(places) - MAX_LISTED) > 0:
        items.append(f"<li>{counted(more, 'more place')} in the layer of the map.</li>")
    body = item_list(items) if items else '<p class="good">No place would need another drive.</p>'
    return f'<section id="confidence"><h2>Where the map is poorly known</h2><p>{shares}. {NOTE}</p>{body}</section>'
