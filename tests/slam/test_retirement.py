"""What is no longer where it was leaves the map; what still is there stays, and nobody who stood somewhere is a wall."""

import copy
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import se2
from drivers.messages import Message
from drivers.simulator import Lidar, Simulation
from drivers.world import Passing, World
from slam import Slam
from slam.config import Config, config_to_toml
from slam.events import Finished, MapLines
from slam.landmarks import CELL, STANDING, Landmarks
from slam.outputs import CONFIG
from slam.retirement import BEHIND, SAME, STEEPEST, sight
from slam.sessions import StoredSession, read_stored, write_stored

LIDAR = Lidar(beams=360)
NOTHING = np.zeros((0, 4)), np.zeros((0, 3))
PATH = np.array([[1.2, 1.2], [6.8, 1.2], [6.8, 4.8], [1.2, 4.8], [1.2, 1.4], [6.5, 1.4]])
START = np.array([1.2, 1.2, 0.0])  # of that path: the map's frame in the world


def box(x: float, y: float, width: float, depth: float) -> list[list[float]]:
    """Four sides around a middle."""
    ends = [(x - width / 2, y - depth / 2), (x + width / 2, y - depth / 2)]
    ends += [(x + width / 2, y + depth / 2), (x - width / 2, y + depth / 2)]
    return [[*a, *b] for a, b in zip(ends, ends[1:] + ends[:1], strict=True)]


ROOM = np.array([*box(4.0, 3.0, 8.0, 6.0), *box(7.6, 5.8, 0.8, 0.4), *box(0.25, 0.2, 0.5, 0.4)])
PARTITION = np.array(box(4.0, 3.0, 3.0, 0.1))


def world(*, always: np.ndarray = ROOM, passing: Sequence[Passing] = ()) -> World:
    return World("room", "a room", always, np.zeros((0, 3)), PATH, 0.7, tuple(passing))


def drive(place: World, seed: int = 0, shift: float = 0.0, duration: float | None = None) -> list[Message]:
    messages = Simulation(place, seed=seed, lidar=LIDAR, duration=duration)
    return [replace(message, stamp=message.stamp + shift) for message in messages]


def run(messages: Sequence[Message], resumed: StoredSession | None = None, *, refine: bool = False) -> tuple[Slam, Finished]:
    slam = Slam(resumed=resumed, refine=refine)
    for message in messages:
        slam.add(message)
    return slam, slam.finish()


def leave(session: StoredSession, directory: Path) -> Path:
    directory.mkdir()
    (directory / CONFIG).write_text(config_to_toml(Config()))
    write_stored(directory, session)
    return directory


def length_on(lines: MapLines, segments: np.ndarray, within: float = 0.1) -> float:
    """Metres of the map's walls that lie on some segments of the world."""
    points, _ = lines.piece_points()
    total = 0.0
    for start, end in points:
        count = max(1, round(float(np.hypot(*(end - start))) / 0.05))
        parts = ((np.arange(count) + 0.5) / count)[:, None]
        for place in se2.transform(START, start + parts * (end - start)).reshape(-1, 2):
            begin, along = segments[:, :2], segments[:, 2:] - segments[:, :2]
            at = np.clip(np.sum((place - begin) * along, axis=1) / np.sum(along**2, axis=1), 0.0, 1.0)
            total += 0.05 * (np.hypot(*(begin + at[:, None] * along - place).T).min() < within)
    return total


@pytest.fixture(scope="module")
def furnished() -> tuple[Slam, Finished]:
    """A room with a partition, mapped."""
    return run(drive(world(always=np.concatenate([ROOM, PARTITION]))))

if __name__=="__main__":
    import sys, tempfile
    from slam.warmup import warm_up
    warm_up()
    import time
    t=time.time()
    slam, f = run(drive(world(always=np.concatenate([ROOM, PARTITION]))))
    print(time.time()-t, "partition", length_on(f.lines, PARTITION), "room", length_on(f.lines, ROOM), f.summary["retired_walls"], f.summary["keyframes"], slam.belief.mapper.landmarks.opened)
    d=leave(slam.session, Path(tempfile.mkdtemp())/"out")
    for seed in range(3):
        slam2, f2 = run(drive(world(), seed=seed+1, shift=1000.0), read_stored(d))
        lm=slam2.belief.mapper.landmarks; r=lm.walls.rows
        print("removed: partition", length_on(f2.lines, PARTITION), "room", length_on(f2.lines, ROOM), f2.summary["retired_walls"], f2.summary["keyframes"], r["retired_at"][r["retired_at"]>=0], {w:len(c) for w,c in lm.opened.items()}, slam2.session.starts)
        slam2, f2 = run(drive(world(always=np.concatenate([ROOM, PARTITION])), seed=seed+1, shift=1000.0), read_stored(d))
        print("kept: partition", length_on(f2.lines, PARTITION), "room", length_on(f2.lines, ROOM), f2.summary["retired_walls"])
    for seed in range(3):
        person = Passing(0.0, 7.0, NOTHING[0], np.array([[4.0, 3.0, 0.25]]))
        slam3, f3 = run(drive(world(passing=[person]),seed=seed))
        a=length_on(f3.lines, np.array(box(4.0,3.0,0.4,0.4)),0.2)
        import slam.retirement as R
        o=R.Doubts.look; R.Doubts.look=lambda *a: False
        slam3, f4 = run(drive(world(passing=[person]),seed=seed)); R.Doubts.look=o
        print("person", a, "without", length_on(f4.lines, np.array(box(4.0,3.0,0.4,0.4)),0.2), f3.summary["retired_walls"], "room", length_on(f3.lines, ROOM),length_on(f4.lines, ROOM))
