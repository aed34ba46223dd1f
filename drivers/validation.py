"""Text of the first error in data that a model of pydantic refuses."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pydantic import ValidationError

MAX_PLACE = 200
"""Characters of a place: keys of damaged files may be long."""


def first_problem(error: ValidationError) -> str:
    """Return the place and the text of the first error as one line, as `walls.0.from: input should be a valid list`."""
    first = error.errors()[0]
    place = ".".join(" ".join(str(part).split()) for part in first["loc"])
    text = first["msg"].removeprefix("Value error, ")  # a prefix that says nothing
    if first["type"] == "model_type":
        text = "must be an object with named values"
    return f"{place[:MAX_PLACE]}: {text[:1].lower()}{' '.join(text[1:].split())}"
