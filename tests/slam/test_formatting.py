"""Numbers in messages."""

from __future__ import annotations

import pytest

from slam.formatting import percent_apart


@pytest.mark.parametrize(
    ("share", "text"), [(0.6, "60 %"), (0.744, "74 %"), (0.748, "74.8 %"), (0.74999, "74.999 %"), (0.75, "75.000000 %")]
)
def test_a_share_has_the_digits_that_tell_it_from_a_limit(share: float, text: str) -> None:
    assert percent_apart(share, 0.75) == text
