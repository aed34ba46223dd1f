"""Write the HTML page of a session: a single file without network access, readable on a phone."""

from __future__ import annotations

from .page import check_page, write_page, write_report_page

__all__ = ["check_page", "write_page", "write_report_page"]
