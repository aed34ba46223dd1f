"""Classes of data that the type checker keeps from being changed."""

from __future__ import annotations

import copy
import pickle
from dataclasses import field, replace
from pathlib import Path

import pytest

from drivers.immutable import immutable

ROOT = Path(__file__).parents[2]


@immutable
class Pair:
    """Two values."""

    first: int
    second: list[int] = field(default_factory=list)


def test_objects_are_equal_only_to_themselves_and_can_be_replaced_copied_and_stored() -> None:
    pair = Pair(1)
    same = [pair, copy.copy(pair), copy.deepcopy(pair), pickle.loads(pickle.dumps(pair)), replace(pair, first=1)]
    assert [(other.first, other.second) for other in same] == 5 * [(1, [])]
    assert [other == pair for other in same] == [True, False, False, False, False]
    assert len(set(same)) == 5


def test_objects_are_represented_as_those_of_data_classes_are() -> None:
    assert repr(Pair(1, [2])) == "Pair(first=1, second=[2])"


def test_objects_have_no_other_attributes() -> None:
    with pytest.raises(AttributeError):
        Pair(1).third = 3  # type: ignore[attr-defined]


def test_all_such_classes_are_declared_in_one_way() -> None:
    slow = "@dataclass(frozen=True, slots=True, eq=False)"
    sources = [source for package in ("drivers", "slam") for source in (ROOT / package).rglob("*.py")]
    assert [source.name for source in sources if slow in source.read_text()] == []
