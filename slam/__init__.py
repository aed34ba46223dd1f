"""2-D SLAM with walls and corners as landmarks.

import slam

slam.run("intel.clf")  # map, path and plots of a recording; displays itself in a notebook

import drivers
from slam import Slam, warm_up

warm_up()  # only needed online: compiles for a minute after an installation, so that no scan is delayed by it
pipeline = Slam()
for message in drivers.open("intel.clf"):
    pipeline.add(message)
result = pipeline.finish()  # trajectory, walls and corners with covariances
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .config import Config, load_config
    from .errors import SlamError
    from .events import Event, Finished, Sink
    from .mapped_recording import MappedRecording
    from .mapping.map_features import Keyframes, MapCorners, MapWalls
    from .pipeline import Slam
    from .run_recording import run
    from .run_saving import save_run
    from .session_correction import correct, undo_correction
    from .warmup import warm_up

__all__ = [
    "Config",
    "Event",
    "Finished",
    "Keyframes",
    "MapCorners",
    "MapWalls",
    "MappedRecording",
    "Sink",
    "Slam",
    "SlamError",
    "correct",
    "load_config",
    "run",
    "save_run",
    "undo_correction",
    "warm_up",
]

_MODULES = {
    "Config": "config",
    "Event": "events",
    "Finished": "events",
    "Keyframes": "mapping.map_features",
    "MapCorners": "mapping.map_features",
    "MapWalls": "mapping.map_features",
    "MappedRecording": "mapped_recording",
    "Sink": "events",
    "Slam": "pipeline",
    "SlamError": "errors",
    "correct": "session_correction",
    "load_config": "config",
    "run": "run_recording",
    "save_run": "run_saving",
    "undo_correction": "session_correction",
    "warm_up": "warmup",
}


def __getattr__(name: str) -> Any:
    # Imported on first use: GTSAM and numba take most of a second to load, and the command line checks for other
    # packages named `drivers` or `features` before anything imports them.
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_MODULES[name]}", __name__), name)
