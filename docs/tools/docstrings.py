"""Render the project's docstrings in the API reference.

Docstrings list fields in two columns, `name  description`, with indented continuation lines. This Griffe extension
turns such lists into Markdown lists.
"""

from __future__ import annotations

import re
from typing import Any

import griffe

FIELD = re.compile(r"^(?P<names>[A-Za-z_][\w.]*(?:, [A-Za-z_][\w.]*)*) {2,}(?P<text>\S.*)$")


def lists_from_columns(text: str) -> str:
    """Return the docstring with every line `name  description`, and its continuation lines, as a list item."""
    result: list[str] = []
    in_list = False
    for line in text.split("\n"):
        field = FIELD.match(line)
        if field is not None:
            if not in_list and result and result[-1]:
                result.append("")
            names = ", ".join(f"`{name}`" for name in field["names"].split(", "))
            result.append(f"- {names}: {field['text']}")
            in_list = True
        elif in_list and line.startswith("  ") and line.strip():
            result.append(f"  {line.strip()}")
        else:
            in_list = False
            result.append(line)
    return "\n".join(result)


class FieldLists(griffe.Extension):
    """Griffe extension that applies `lists_from_columns` to every docstring."""

    def on_instance(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Rewrite the docstring of an object."""
        if obj.docstring is not None:
            obj.docstring.value = lists_from_columns(obj.docstring.value)
