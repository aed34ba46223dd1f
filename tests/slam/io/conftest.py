"""Sessions of a short run."""

from pathlib import Path

import pytest

from drivers.simulation import LIDAR_MODELS, Simulation
from slam import Slam
from slam.config import Config, config_to_toml
from slam.io.output_dir import CONFIG
from slam.io.sessions import Recording, StoredSession, write_session

ROOM = Recording(name="room", path="sim:room", first=0.0, last=8.0)


def write_directory(directory: Path, session: StoredSession) -> None:
    directory.mkdir(exist_ok=True)
    (directory / CONFIG).write_text(config_to_toml(session.config))
    write_session(directory, session)


def map_room(directory: Path, *, refine: bool) -> StoredSession:
    """Map a drive of eight seconds, write the session to a directory, and return it."""
    slam = Slam(Config(), refine=refine)
    for message in Simulation("room", seed=3, duration=8.0, lidar=LIDAR_MODELS["short"]):
        slam.add(message)
    slam.finish()
    session = slam.session
    session.recordings.append(ROOM)
    write_directory(directory, session)
    return session


@pytest.fixture(scope="session", params=[False, True], ids=["online", "refined"])
def written(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[StoredSession, Path]:
    path = tmp_path_factory.mktemp("run") / "out"
    return map_room(path, refine=request.param), path


@pytest.fixture(scope="session")
def intact(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Directory with a session of which tests damage copies; one that was refined is read in the same way."""
    path = tmp_path_factory.mktemp("intact") / "out"
    map_room(path, refine=False)
    return path
