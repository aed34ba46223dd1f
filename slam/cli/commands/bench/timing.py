"""Settings of benchmarks on recordings."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from drivers.messages import Source

    from ....config import Config


def resolve_timing(source: Source) -> Config:
    """Return the default settings with what a recording shows of its lidar and odometry, as `wclm run` uses them."""
    from ....config import Config
    from ....io.recording_timing import RecordingTiming
    from ....io.recordings import reason_without_odometry

    config = Config() if reason_without_odometry(source) is None else Config().without_odometry()
    return RecordingTiming.of(source, config.lidar).compensated(config)
