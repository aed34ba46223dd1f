"""Texts of errors: one line that can be read, whatever a damaged file contains."""

from __future__ import annotations

from drivers.errors import MAX_HALF_TEXT, RecordingError, SlamError


def test_line_breaks_and_control_characters_are_replaced() -> None:
    assert str(SlamError("a name with\na break and\x1b[31m")) == "a name with\ufffda break and\ufffd[31m"


def test_long_values_are_shortened_between_the_place_and_the_reason() -> None:
    text = str(RecordingError("drive.clf", 60, f"{100_000 * '9'} is no stamp"))
    assert text.startswith("drive.clf:60: 999")
    assert text.endswith("999 is no stamp")
    assert len(text) <= 2 * MAX_HALF_TEXT + len(" ... ")


def test_short_texts_are_shown_as_they_are() -> None:
    assert str(RecordingError("drive.clf", 60, "no beams")) == "drive.clf:60: no beams"
