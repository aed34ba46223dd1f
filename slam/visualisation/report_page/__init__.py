"""A session as one page for the browser: everything in one file, no network, readable on a phone."""

from __future__ import annotations

from .page import write_page

__all__ = ["write_page"]
