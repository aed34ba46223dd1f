"""Places that a person states to be one are matched, or refused with the reason."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers import se2
from drivers.messages import Odometry, Scan
from drivers.simulation import Simulation
from slam import Slam
from slam.errors import MapError
from slam.estimation.slam_state import SlamState
from slam.offline.corrections.place_match import match_places

WORLD = """
title = "two rooms"
speed = 0.8
path = [[1.0, 1.0], [5.0, 1.2], [10.5, 1.5], [12.0, 4.0], [10.0, 4.2], [10.0, 1.5], [5.0, 1.2], [1.0, 1.2]]

[[walls]]
from = [0, 0]
to = [6, 0]
[[walls]]
from = [6, 0]
to = [6, 0.7]
[[walls]]
from = [6, 2.0]
to = [6, 4]
[[walls]]
from = [6, 4]
to = [0, 3.2]
[[walls]]
from = [0, 3.2]
to = [0, 0]
[[walls]]
from = [6.2, 0]
to = [13, 0]
[[walls]]
from = [13, 0]
to = [13, 6]
[[walls]]
from = [13, 6]
to = [8, 6]
[[walls]]
from = [8, 6]
to = [6.2, 3]
[[walls]]
from = [6.2, 3]
to = [6.2, 2.0]
[[walls]]
from = [6.2, 0.7]
to = [6.2, 0]

[[boxes]]
at = [3.0, 2.4]
size = [1.2, 0.7]
turn = 10
"""


@pytest.fixture(scope="module")
def state(tmp_path_factory: pytest.TempPathFactory) -> SlamState:
    """State after a drive from one room into another one and back."""
    world = Path(tmp_path_factory.mktemp("world") / "rooms.toml")
    world.write_text(WORLD)
    slam = Slam()
    for message in Simulation(world, seed=1):
        if isinstance(message, Scan | Odometry):
            slam.add(message)
    slam.finish()
    return slam.slam_state


def test_one_place_is_matched_from_wherever_it_is_in_the_map(state: SlamState) -> None:
    last, poses = state.mapper.keyframe_count - 1, state.mapper.keyframe_poses
    old = int(np.argmin(np.hypot(*(poses[: last // 3, :2] - poses[last, :2]).T)))
    look, match = match_places(state, old, last, None)
    assert look.last == last
    np.testing.assert_allclose(match.pose, se2.between(poses[old], poses[last]), atol=0.05)
    _, proposed = match_places(state, old, last, np.array([0.2, -0.1, 0.05]))
    np.testing.assert_allclose(proposed.pose, match.pose, atol=0.01)


def test_other_places_are_refused_with_the_reason(state: SlamState) -> None:
    mapper = state.mapper
    last, travelled = mapper.keyframe_count - 1, np.array(mapper.travelled)
    with pytest.raises(MapError, match=r"keyframes 0 and 5: only .* m of driving apart"):
        match_places(state, 0, 5, None)
    elsewhere = int(np.searchsorted(travelled, 14.0))
    with pytest.raises(MapError, match=rf"keyframes 0 and {elsewhere} are not one place: .*(fit|seen)"):
        match_places(state, 0, elsewhere, None)
    mapper.landmarks.parts.begin(last, measured=False)
    with pytest.raises(MapError, match="parts of the map that are not connected"):
        match_places(state, 0, last, None)
