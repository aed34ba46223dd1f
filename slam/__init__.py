"""2-D SLAM on walls and corners.

import drivers
from slam import Slam, warm_up

warm_up()  # live only: compiles the first time, for half a minute, so that no scan has to wait for it
slam = Slam()
for message in drivers.open("intel.clf"):
    slam.add(message)
result = slam.finish()  # path, walls and corners with covariances
"""

from typing import TYPE_CHECKING, Any

from .config import Config, load_config
from .errors import SlamError
from .events import Event, Finished, MapCorners, MapWalls, Sink

if TYPE_CHECKING:
    from .pipeline import Slam
    from .warmup import warm_up

__all__ = [
    "Config",
    "Event",
    "Finished",
    "MapCorners",
    "MapWalls",
    "Sink",
    "Slam",
    "SlamError",
    "load_config",
    "warm_up",
]


def __getattr__(name: str) -> Any:
    # GTSAM and numba take most of a second to load: only who makes maps pays for them
    if name == "Slam":
        from .pipeline import Slam

        return Slam
    if name == "warm_up":
        from .warmup import warm_up

        return warm_up
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
