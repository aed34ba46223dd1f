"""Page of a live run: a web server whose single page shows the map while it grows, also on a phone."""

from __future__ import annotations

from .grid_layer import GridLayer
from .live_state import LiveState
from .requests import PageActions
from .server import PageServer

__all__ = ["GridLayer", "LiveState", "PageActions", "PageServer"]
