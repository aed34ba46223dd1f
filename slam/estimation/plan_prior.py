"""Mapping with a plan: recognise the map in it, and let its walls support those of the map that agree with it.

The robot maps as without a plan, in a frame of its own, until the drive is recognised in the plan. Then the map is
moved to the plan's frame. From then on a wall that agrees with the plan gets a factor with what the plan states about
it; a wall that differs gets none. At the end of the run all walls are tested again, and factors that the finished map
contradicts are removed.
"""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

import numpy as np

from drivers import se2

from ..geometry.pose_covariance import position_sigma
from ..geometry.segments import Floats, Integers
from ..graph.factor_graph import CLOSING_UPDATES
from ..loop_closure.closing import LOOP_FACTOR_COVARIANCE
from ..loop_closure.submap_search import SUBMAP_LENGTH
from ..mapping.frame_change import change_frame
from ..mapping.local_map import MAX_PREDICTED_VARIANCE
from ..mapping.map_features import MapWalls
from ..mapping.plan_map import PlanMap
from ..mapping.plan_walls import PlanWall, contradicts, walls_on_plan
from .plan_recognition import RECENT_DISTANCE, PlacedMap, PlanRecognition, pose_covariance_in_plan

if TYPE_CHECKING:
    from ..localisation.local_field import LocalField
    from ..mapping.mapper import Mapper

# Walls that must agree with the plan where the map was recognised. Origin: definition, three determine a pose.
MIN_AGREEING_WALLS = 3
# Rounds of tests at the end: walls that are supported determine their neighbours better. Origin: numerical.
MAX_ROUNDS = 20


class PlanPrior:
    """A plan, and what is known about the place of the map in it.

    recognised  true if the map is in the plan's frame
    """

    def __init__(self, plan_map: PlanMap, start: se2.Pose | None, start_covariance: Floats) -> None:
        """Prepare a plan for recognition. Raises MapError if it shows too little.

        start  roughly known pose of the base in the plan at the first scan, with its covariance (3, 3)
        """
        self.plan_map = plan_map
        self.recognised = False
        self._recognition = PlanRecognition(plan_map, start, start_covariance)
        self._supported: set[int] = set()  # walls of the map
        self._observed = -1  # last keyframe whose walls were compared with the plan
        self._last_supported = 0  # last keyframe that the plan supports

    def __deepcopy__(self, memo: dict[int, object]) -> PlanPrior:
        """Return an independent copy; the plan is never changed and is shared."""
        other = copy.copy(self)
        other._recognition, other._supported = copy.deepcopy(self._recognition, memo), set(self._supported)
        return other

    def update(self, mapper: Mapper, local_field: LocalField) -> bool:
        """Update the map after the graph was solved and read back.

        Return True if it was recognised in the plan: moved to its frame, or corrected after a drift.
        """
        if mapper.landmarks.parts.current_is_apart or not mapper.is_solved:
            return False
        if self.recognised:
            self._support_observed(mapper)
            if self._is_supported(mapper):
                self._recognition.discard_submaps()
                return False
        found = self._recognition.search(mapper, local_field, self._last_supported if self.recognised else None)
        if found is None:
            return False
        return self._correct(mapper, found.motion) if self.recognised else self._move_to_plan(mapper, found)

    def correct_drift(self, mapper: Mapper, local_field: LocalField) -> None:
        """Search for the robot once more at the end of a run, before the map converges, if it has left the plan."""
        mapper.solve_waiting()
        if not self.recognised or mapper.landmarks.parts.current_is_apart or self._is_supported(mapper):
            return
        found = self._recognition.find(mapper, local_field, self._last_supported)
        if found is not None:
            self._correct(mapper, found.motion)

    def settle(self, mapper: Mapper, local_field: LocalField) -> bool:
        """Test all walls of a finished map, which has converged; return False if it is not recognised in the plan."""
        if not self.recognised:
            found = self._recognition.find(mapper, local_field)
            if found is None or not self._move_to_plan(mapper, found):
                return False
        graph, refuted = mapper.graph, set[int]()
        is_new_graph = not graph.plan_walls()  # after a refinement, which builds a graph without factors of the plan
        current = set(self._candidates(mapper).tolist())  # without merged walls, in place of which others are tested
        graph.remove_factors(factor for wall, factor in graph.plan_walls().items() if wall not in current)
        for _ in range(MAX_ROUNDS):
            walls = self._candidates(mapper)
            frames, covariances = graph.wall_frames(walls.tolist()), _covariances(mapper, walls)
            supported, row = graph.plan_walls(), {wall: k for k, wall in enumerate(walls.tolist())}
            wrong = [
                wall
                for wall, factor in supported.items()
                if wall in row
                and contradicts(frames[row[wall]], covariances[row[wall]], factor.measured, factor.covariance)
            ]
            refuted.update(wrong)
            new = np.array([wall not in supported and wall not in refuted for wall in walls.tolist()], dtype=bool)
            added = walls_on_plan(walls[new], frames[new], _extents(mapper, walls[new]), covariances[new], self._walls)
            if not wrong and not added:
                break
            self._support(mapper, added)
            graph.remove_factors(supported[wall] for wall in wrong)
            graph.update_until_converged()
            mapper.read_back_all()
        self._supported = set(graph.plan_walls())
        if is_new_graph and len(self._supported) >= MIN_AGREEING_WALLS:
            # Its first keyframe is still fixed. From now on the walls determine it.
            change_frame(mapper, np.zeros(3))
            return self.settle(mapper, local_field)
        return True

    @property
    def _walls(self) -> MapWalls:
        """Walls of the plan."""
        return self.plan_map.walls

    def _move_to_plan(self, mapper: Mapper, found: PlacedMap) -> bool:
        """Move the map into the plan, and let the plan support the walls around its place that agree with it.

        Returns False, and changes nothing, if too few walls agree.
        """
        last, walls = mapper.keyframe_count - 1, self._recent(mapper, found.keyframe)
        relative = mapper.graph.relative_covariances([found.keyframe], walls.tolist(), []).walls
        frames = se2.compose(found.motion, mapper.graph.wall_frames(walls.tolist())).reshape(-1, 3)
        lever = frames[:, :2] - se2.compose(found.motion, mapper.keyframe_poses[found.keyframe])[:2]
        c, s = np.cos(frames[:, 2]), np.sin(frames[:, 2])
        jacobian = np.zeros((len(walls), 2, 3))
        jacobian[:, 0] = np.column_stack([-s, c, c * lever[:, 0] + s * lever[:, 1]])
        jacobian[:, 1, 2] = 1.0
        covariances = relative + jacobian @ found.covariance @ jacobian.transpose(0, 2, 1)
        agreeing = walls_on_plan(walls, frames, _extents(mapper, walls), covariances, self._walls)
        if len(agreeing) < MIN_AGREEING_WALLS:
            return False
        change_frame(mapper, found.motion)
        self._support(mapper, agreeing)
        mapper.graph.update()
        mapper.graph.update_until_converged()
        mapper.read_back_all()
        mapper.equalise_covariances()
        self.recognised, self._last_supported, self._observed = True, found.keyframe, last
        return True

    def _correct(self, mapper: Mapper, motion: se2.Pose) -> bool:
        """Move the last keyframe by a motion, which is a correction of drift, and let the plan support its walls.

        A temporary prior moves the map into place: the walls that agree with the plan then hold it there.
        """
        graph, last = mapper.graph, mapper.keyframe_count - 1
        temporary = graph.add_keyframe_prior(last, se2.compose(motion, mapper.pose), LOOP_FACTOR_COVARIANCE)
        graph.update()
        graph.update_until_converged(CLOSING_UPDATES)
        mapper.read_back_all()
        walls = self._recent(mapper, last)
        walls = walls[~self._are_supported(walls)]
        frames, covariances = graph.wall_frames(walls.tolist()), _covariances(mapper, walls)
        self._support(mapper, walls_on_plan(walls, frames, _extents(mapper, walls), covariances, self._walls))
        graph.remove_factors([temporary])
        graph.update_until_converged(CLOSING_UPDATES)
        mapper.read_back_all()
        self._last_supported = last
        self._recognition.discard_submaps()
        return True

    # --- support

    def _is_supported(self, mapper: Mapper) -> bool:
        """Return True if the plan has supported a keyframe in the last metres of driving."""
        return mapper.travelled[-1] - mapper.travelled[self._last_supported] < SUBMAP_LENGTH

    def _support_observed(self, mapper: Mapper) -> None:
        """Let the plan support the walls observed since the last solution of the graph, if they agree with it."""
        last, walls = mapper.keyframe_count - 1, self._candidates(mapper)
        rows = mapper.landmarks.walls.rows
        walls, self._observed = walls[rows["last_seen"][walls] > self._observed], last
        known = self._are_supported(walls)
        new = walls[~known]
        normal = np.column_stack([-np.sin(rows["frame"][new, 2]), np.cos(rows["frame"][new, 2])])
        drift = mapper.correlated_drift[last] - mapper.correlated_drift[self._last_supported]
        covariances = rows["covariance_in_map"][new].copy()
        covariances[:, 0, 0] += np.maximum(np.einsum("ni,ij,nj->n", normal, drift, normal), 0.0)
        agreeing = walls_on_plan(new, rows["frame"][new], _extents(mapper, new), covariances, self._walls)
        if agreeing:
            self._support(mapper, agreeing)
            mapper.graph.update()
        if (agreeing or known.any()) and self._walls_are_comparable(mapper):
            self._last_supported = last

    def _walls_are_comparable(self, mapper: Mapper) -> bool:
        """Return True if the position in the plan is so well known that walls of all directions can agree with it.

        Along a corridor it may be lost although the walls on both sides agree.
        """
        covariance = pose_covariance_in_plan(mapper, self._last_supported)
        return position_sigma(covariance) ** 2 < MAX_PREDICTED_VARIANCE

    def _support(self, mapper: Mapper, stated: list[PlanWall]) -> None:
        """Add what the plan states about walls to the graph, effective with its next update.

        Walls of the map that are one wall in the plan share its error: each gets its share of the information.
        """
        rows = [one.row for one in stated]
        for one in stated:
            mapper.graph.add_plan_wall(one.wall, one.frame, one.covariance * rows.count(one.row))
        self._supported.update(one.wall for one in stated)

    def _are_supported(self, walls: Integers) -> np.ndarray:
        """Return (n,) which walls the plan supports."""
        return np.array([wall in self._supported for wall in walls.tolist()], dtype=bool)

    def _recent(self, mapper: Mapper, keyframe: int) -> Integers:
        """Return the walls that can be compared with the plan and were seen shortly before a keyframe, or later."""
        travelled, walls = np.asarray(mapper.travelled), self._candidates(mapper)
        seen = travelled[mapper.landmarks.walls.rows["last_seen"][walls]]
        return np.asarray(walls[seen > travelled[keyframe] - RECENT_DISTANCE])

    @staticmethod
    def _candidates(mapper: Mapper) -> Integers:
        """Return the walls of the map that can be compared with the plan."""
        landmarks = mapper.landmarks
        return np.flatnonzero(landmarks.walls.rows["in_graph"] & landmarks.active() & landmarks.connected(keyframe=0))


def _extents(mapper: Mapper, walls: Integers) -> Floats:
    """Return begin and end (n, 2) of walls along their frames."""
    rows = mapper.landmarks.walls.rows[walls]
    return np.column_stack([rows["low"], rows["high"]])


def _covariances(mapper: Mapper, walls: Integers) -> Floats:
    """Return the covariance (n, 2, 2) of each wall in the map."""
    blocks = mapper.graph.wall_covariances([[wall] for wall in walls.tolist()])
    return np.array(blocks).reshape(-1, 2, 2)
