"""Adapt the layout to the map: for live viewers as the map grows, and at the end of the log."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...geometry.segments import Floats
from .blueprint import Extent, layout
from .rrd_writer import RrdWriter
from .shapes import bounds

GROWTH_MARGIN = 0.25  # of the map's size on each side, added when live viewers are shown more of the map
NO_MAP = bounds(np.empty((0, 2)))
"""Area that is shown before anything was mapped."""


class ShownArea:
    """Area of the map that the layout shows."""

    def __init__(self, writer: RrdWriter, *, has_live_viewers: bool) -> None:
        self._writer, self._has_live_viewers = writer, has_live_viewers
        self._area = self._shown = NO_MAP  # corners of the map's box, and of the box that live viewers are shown
        self._decided = False

    def enlarge(self, low: Floats, high: Floats) -> None:
        """Show live viewers the whole map, with the corners (2,) of its box in metres, once it exceeds the view.

        Changes that viewers made in the layout are lost then.
        """
        self._area = low, high
        shown_low, shown_high = self._shown
        if np.all(low >= shown_low) and np.all(high <= shown_high):
            return
        margin = GROWTH_MARGIN * float(np.max(high - low))
        self._shown = low - margin, high + margin
        self._update_live_viewers()

    def show_decisions(self) -> None:
        """Show live viewers the table of loop decisions, once there are any."""
        if not self._decided:
            self._decided = True
            self._update_live_viewers()

    def finish(self, **content: Any) -> None:
        """Fit the layout to the whole map; `content` as in `Extent`."""
        self._writer.set_layout(layout(Extent(*self._area, decided=self._decided, **content)))

    def _update_live_viewers(self) -> None:
        if self._has_live_viewers:
            self._writer.set_layout(layout(Extent(*self._shown, decided=self._decided, running=True)))
