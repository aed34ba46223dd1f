"""Units of length of drawings."""

from __future__ import annotations

from enum import StrEnum


class Unit(StrEnum):
    """Units of length of drawings."""

    METRE = "m"
    CENTIMETRE = "cm"
    MILLIMETRE = "mm"
    FOOT = "ft"
    INCH = "in"


METRES = {Unit.METRE: 1.0, Unit.CENTIMETRE: 0.01, Unit.MILLIMETRE: 0.001, Unit.FOOT: 0.3048, Unit.INCH: 0.0254}
"""Metres per unit."""
