"""What several tests need: a small map, and the paths of folders that tests write into."""

import numpy as np
import pytest

from slam.events import Finished, MapCorners, MapLines


@pytest.fixture
def finished() -> Finished:
    """A room of 6 m by 4 m, seen from inside, and a path through it."""
    frames = np.array([[3, 0, 0], [6, 2, np.pi / 2], [3, 4, np.pi], [0, 2, -np.pi / 2]], float)
    half = np.array([3.0, 2.0, 3.0, 2.0])
    lines = MapLines(
        identity=np.array([0, 1, 3, 7]),
        frame=frames,
        low=-half,
        high=half,
        observations=np.array([5, 4, 3, 2]),
        covariance=np.stack([*np.tile(np.diag([1e-5, 1e-7]), (3, 1, 1)), np.full((2, 2), np.nan)]),
    )
    corners = MapCorners(
        identity=np.array([0, 1]),
        position=np.array([[6.0, 0.0], [6.0, 4.0]]),
        covariance=np.array([[[4e-5, 1e-5], [1e-5, 2e-5]], np.full((2, 2), np.nan)]),
        lines=np.array([[0, 1], [1, 3]]),
        observations=np.array([3, 2]),
    )
    stamps = np.linspace(0, 20, 101)
    poses = np.column_stack([1 + 0.2 * stamps, 2 + np.sin(stamps / 4), np.arctan2(np.cos(stamps / 4) / 4, 0.2)])
    return Finished(lines, corners, stamps[::20], poses[::20], stamps, poses, {"closures": 0})
