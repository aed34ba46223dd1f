"""Run SLAM in one's own sensor loop and use the pose while driving.

    python examples/own_sensors.py

The sensors are those of a simulated robot that drives in a circle in a square room; replace them by your own.
"""

import numpy as np

from drivers import Odometry, Scan
from slam import Config, Slam, warm_up

BEAMS, RATE, SIDE = 360, 10.0, 5.0  # beams per scan, scans per second, metres
ANGLES = -np.pi + 2 * np.pi / BEAMS * (np.arange(BEAMS) + 0.5)  # counter-clockwise, in the lidar's frame


def read_wheels(time: float) -> np.ndarray:
    """Return the odometry [x, y, heading] since the start, metres and radians: a circle with a radius of one metre."""
    turn = 0.4 * time
    return np.array([np.sin(turn), 1.0 - np.cos(turn), turn])


def read_lidar(time: float, random: np.random.Generator) -> np.ndarray:
    """Return the ranges (BEAMS,) in metres, NaN for no-returns."""
    x, y, heading = read_wheels(time)
    c, s = np.cos(ANGLES + heading), np.sin(ANGLES + heading)
    distance = np.minimum((np.sign(c) * SIDE / 2 - x) / c, (np.sign(s) * SIDE / 2 - (y - 1.0)) / s)
    ranges = distance + random.normal(0.0, 0.01, BEAMS)
    ranges[random.random(BEAMS) < 0.02] = np.nan
    return ranges


# Noise from the lidar's data sheet, and the mount of the lidar on the robot: x, y, heading.
config = Config.model_validate({"lidar": {"sigma_range": 0.01, "mount": (0.0, 0.0, 0.0)}})

warm_up()  # compiles for a minute the first time; do this before driving
pipeline = Slam(config)
random = np.random.default_rng(0)
for step in range(100):
    time = step / RATE
    pipeline.add(Odometry(time, read_wheels(time)))
    # The time offsets of the beams are used for de-skewing; zeros if all beams are measured at the same time.
    pipeline.add(Scan(time, read_lidar(time, random), ANGLES, np.zeros(BEAMS), range_min=0.1, range_max=12.0))
    if step % 25 == 24:
        x, y, heading = pipeline.pose  # use this pose for control
        print(
            f"{time:4.1f} s: at {x:.3f} m, {y:.3f} m, {np.degrees(heading):6.1f} degrees; {len(pipeline.walls)} walls"
        )

result = pipeline.finish()
print(f"the room has {len(result.walls)} walls and {len(result.corners)} corners")
