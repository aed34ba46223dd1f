"""Walls that are one: by the map, and by the factors of its graph."""

from __future__ import annotations

from slam.graph.factors import FactorKind
from slam.mapping.landmark_table import UNOBSERVED
from slam.mapping.mapper import Mapper


def assert_merged_walls_are_equal_in_the_graph(mapper: Mapper) -> None:
    """Assert that equalities in the graph tie the walls to each other that are merged into one, and no others."""
    groups = mapper.landmarks.walls.rows["merged_into"].tolist()
    equal = list(range(len(groups)))
    for factor in mapper.graph.solver.sorted_factors() + mapper.graph.additions.factors:
        if factor.kind is FactorKind.WALL_EQUALITY:
            one, other = equal[factor.first], equal[factor.second]
            equal = [one if each == other else each for each in equal]
    walls = [wall for wall, group in enumerate(groups) if group != UNOBSERVED]
    assert all((groups[a] == groups[b]) == (equal[a] == equal[b]) for a in walls for b in walls)
