"""Settings of benchmarks on recordings."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from drivers.messages import Source

    from ....config import Config


def resolve_timing(source: Source) -> Config:
    """Return the default settings with the delay of the lidar that a recording shows, as `wclm run` uses them."""
    from ....config import Config
    from ....io.recording_timing import RecordingTiming

    config = Config()
    return RecordingTiming.of(source, config.lidar).compensated(config)
