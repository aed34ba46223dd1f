"""Times since the start, as text."""

from __future__ import annotations

import pytest

from drivers.elapsed import elapsed, parse_elapsed


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.0, "0:00"), (59.99, "0:59"), (476.9, "7:56"), (3599.0, "59:59"), (3600.0, "1:00:00"), (90061.0, "25:01:01")],
)
def test_times_are_written_and_read(seconds: float, text: str) -> None:
    assert elapsed(seconds) == text
    assert parse_elapsed(text) == int(seconds)


def test_a_difference_of_stamps_is_not_a_second_less() -> None:
    assert elapsed(976052900.1 - 976052890.1 - 1e-7) == "0:10"


def test_times_before_the_start_are_negative() -> None:
    assert [elapsed(seconds) for seconds in (-0.3, -61.0)] == ["0:00", "-1:01"]


@pytest.mark.parametrize("text", ["", "12", "1:x", "1:2:3:4", "-1:00", "1:", "1.5:00", 5000 * "1" + ":00"])
def test_other_texts_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="not a time"):
        parse_elapsed(text)
