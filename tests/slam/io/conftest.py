"""Sessions of a short run."""

from pathlib import Path

import pytest

from drivers.simulation import Simulation
from slam import Slam
from slam.config import Config, config_to_toml
from slam.io.output_dir import CONFIG
from slam.io.sessions import Recording, StoredSession, write_session

ROOM = Recording(name="room", path="sim:room", first=0.0, last=8.0)


def write_directory(directory: Path, session: StoredSession) -> None:
    directory.mkdir(exist_ok=True)
    (directory / CONFIG).write_text(config_to_toml(session.config))
    write_session(directory, session)


@pytest.fixture(scope="session", params=[False, True], ids=["online", "refined"])
def written(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[StoredSession, Path]:
    slam = Slam(Config(), refine=request.param)
    for message in Simulation("room", seed=3, duration=8.0):
        slam.add(message)
    slam.finish()
    session = slam.session
    session.recordings.append(ROOM)
    path = tmp_path_factory.mktemp("run") / "out"
    write_directory(path, session)
    return session, path
