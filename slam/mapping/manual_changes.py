"""Changes of a map that a person has decided on: walls deleted, and walls tied together."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..graph.rebuilding import without_walls
from .overlap_suppression import suppress_overlapping_walls

if TYPE_CHECKING:
    from .mapper import Mapper


def delete_wall(mapper: Mapper, wall: int) -> None:
    """Delete a shown wall, the walls merged into it, the walls that it hides, and the observations of all of them.

    The graph has been solved with all keyframes; it is solved again. Raises MapError if that leaves a variable
    undetermined.
    """
    landmarks = mapper.landmarks
    deleted = np.flatnonzero(suppress_overlapping_walls(landmarks).walls.rows["merged_into"] == wall).tolist()
    mapper.graph = without_walls(mapper.graph, deleted)
    landmarks.delete_walls(deleted)
    mapper.free_space_evidence.discard(deleted)
    mapper.graph.update_until_converged()
    mapper.read_back_all()


def tie_walls(mapper: Mapper, kept: int, absorbed: int) -> None:
    """Make two walls that are shown one, with the identity `kept`, however far they are apart; solve the graph again.

    Raises MapError if the geometry leaves a variable undetermined.
    """
    mapper.merge_walls(kept, absorbed)
    mapper.graph.update()
    mapper.graph.update_until_converged()
    mapper.read_back_all()


def fragile_changes(mapper: Mapper) -> str:
    """Return in words which changes of a map a refinement would undo, as it associates all features again."""
    deleted = len(mapper.landmarks.deleted_walls()) > 0
    present = {"pins": bool(mapper.graph.pins()), "walls that were deleted by hand": deleted}
    return " and ".join(name for name, found in present.items() if found)
