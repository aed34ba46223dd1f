"""Lidar drivers of other packages, which are installed beside this one.

Such a package has an entry point in the group `wclm.lidars`: its name is the kind in a device spec, and it refers to a
subclass of `LidarDevice`. The reading process finds it in the same way.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..errors import DriverError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from .lidar import LidarDevice

GROUP = "wclm.lidars"
"""Group of the entry points."""


def external_kinds() -> list[str]:
    """Return the kinds of lidars that installed packages add, without loading their drivers."""
    from importlib.metadata import entry_points  # not at the top: few commands need it, and it loads slowly

    return sorted({point.name for point in entry_points(group=GROUP)})


def external_lidar(kind: str) -> type[LidarDevice] | None:
    """Return the driver of a kind of lidar, None if no installed package has one.

    Raises DriverError if it cannot be loaded, is no LidarDevice, or several packages have a driver of this kind.
    """
    from importlib.metadata import entry_points

    from .lidar import LidarDevice

    points = sorted(entry_points(group=GROUP, name=kind), key=_text)
    if not points:
        return None
    if len({point.value for point in points}) > 1:
        raise DriverError(f"several installed packages have a driver {kind}: {', '.join(map(_text, points))}")
    try:
        driver = points[0].load()
    except Exception as error:  # whatever the module of another package raises
        raise DriverError(f"{_text(points[0])}: cannot be loaded: {type(error).__name__}: {error}") from error
    if not (isinstance(driver, type) and issubclass(driver, LidarDevice)):
        raise DriverError(f"{_text(points[0])}: is no subclass of drivers.devices.lidar.LidarDevice")
    return driver


def _text(point: EntryPoint) -> str:
    package = f" of {point.dist.name}" if point.dist is not None else ""
    return f"{point.value}{package}"
