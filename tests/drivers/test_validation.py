"""Errors of invalid data name the place and the problem in one line, without names of the program's own classes."""

import pytest
from pydantic import BaseModel, ConfigDict, ValidationError, field_validator

from drivers.validation import MAX_PLACE, first_problem


class Inner(BaseModel):
    size: float = 1.0

    @field_validator("size")
    @classmethod
    def _check(cls, size: float) -> float:
        if size < 0.0:
            raise ValueError("is no\nsize")
        return size


class Outer(BaseModel):
    model_config = ConfigDict(extra="forbid")
    parts: list[Inner]


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (
            {"parts": [{}, {"size": "wide"}]},
            "parts.1.size: input should be a valid number, unable to parse string as a",
        ),
        ({"parts": [3]}, "parts.0: must be an object with named values"),
        ({"parts": [{"size": -1.0}]}, "parts.0.size: is no size"),
        ({"parts": [], "x" * 5000: 1}, f"{'x' * MAX_PLACE}: extra inputs are not permitted"),
        ({"parts": [], "a\nb": 1}, "a b: extra inputs are not permitted"),
    ],
)
def test_the_first_problem_is_one_line(data: object, text: str) -> None:
    with pytest.raises(ValidationError) as caught:
        Outer.model_validate(data)
    problem = first_problem(caught.value)
    assert problem.startswith(text)
    assert len(problem.splitlines()) == 1
