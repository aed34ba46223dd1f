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
    rows = landmarks.walls.rows
    deleted = np.flatnonzero(suppress_overlapping_walls(landmarks).walls.rows["merged_into"] == wall)
    mapper.graph = without_walls(mapper.graph, deleted.tolist())
    rows["in_graph"][deleted] = False
    for each in deleted.tolist():
        landmarks.remove_wall(each, 0)
    mapper.free_space_evidence.discard(deleted.tolist())
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
