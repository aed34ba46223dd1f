"""Write the HTML page of a session: a single file without network access, readable on a phone."""

from __future__ import annotations

from .page import write_page

__all__ = ["write_page"]
