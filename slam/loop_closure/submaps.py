"""Submaps of old places, of which those that were searched last are kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ..localisation.local_field import LocalField
from ..matching.distance_field import FIELD_HALF_WIDTH
from .loop_hypothesis import OldPlace
from .submap_search import Submap, build_submap

# Submaps of old places that are kept. Origin: measured on four recordings: each has 1.3 MB, and with twice as many, at
# most a fifth to a third fewer are built.
MAX_SUBMAPS = 6


class Submaps:
    """Submaps of the old places that were searched last, by the keyframe in their middle."""

    def __init__(self, places: Sequence[tuple[int, OldPlace]] = (), local_field: LocalField | None = None) -> None:
        """Build the submaps of saved `places`; `local_field` has the points of all keyframes."""
        self._submaps: dict[int, tuple[OldPlace, Submap]] = {}
        if local_field is not None:
            self._submaps = {centre: (place, submap_of(place, local_field)) for centre, place in places}

    def copy(self) -> Submaps:
        """Return an independent copy; submaps are never changed and are shared."""
        other = Submaps()
        other._submaps = dict(self._submaps)
        return other

    @property
    def places(self) -> list[tuple[int, OldPlace]]:
        """Places to be saved."""
        return [(centre, place) for centre, (place, _) in self._submaps.items()]

    def get(self, keyframe: int, place_around: Callable[[int], OldPlace], local_field: LocalField) -> Submap:
        """Return the submap around a keyframe; it is built from `place_around` if it is not kept."""
        if (kept := self._submaps.pop(keyframe, None)) is None:
            place = place_around(keyframe)
            self._submaps = dict([*self._submaps.items()][1 - MAX_SUBMAPS :])
            kept = place, submap_of(place, local_field)
        self._submaps[keyframe] = kept  # the last one now
        return kept[1]


def submap_of(place: OldPlace, local_field: LocalField) -> Submap:
    """Return the submap of a place."""
    return build_submap(place.poses, local_field.points_of(place.keyframes), FIELD_HALF_WIDTH)
