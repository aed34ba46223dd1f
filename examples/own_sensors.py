"""Feed SLAM from one's own sensor loop and use the pose while driving.

    python examples/own_sensors.py

The loop here makes up a robot that turns in a square room; put your own lidar and wheels in its place.
"""

import numpy as np

from drivers import Odometry, Scan
from slam import Config, Slam, warm_up

BEAMS, RATE, SIDE = 360, 10.0, 5.0  # beams a scan, scans a second, metres
ANGLES = -np.pi + 2 * np.pi / BEAMS * (np.arange(BEAMS) + 0.5)  # counter-clockwise, in the lidar's frame


def read_wheels(time: float) -> np.ndarray:
    """[x, y, heading] in metres and radians since the start, as the wheels tell it: a circle of one metre."""
    turn = 0.4 * time
    return np.array([np.sin(turn), 1.0 - np.cos(turn), turn])


def read_lidar(time: float, random: np.random.Generator) -> np.ndarray:
    """(BEAMS,) metres; NaN is for beams that return nothing."""
    x, y, heading = read_wheels(time)
    c, s = np.cos(ANGLES + heading), np.sin(ANGLES + heading)
    distance = np.minimum((np.sign(c) * SIDE / 2 - x) / c, (np.sign(s) * SIDE / 2 - (y - 1.0)) / s)
    ranges = distance + random.normal(0.0, 0.01, BEAMS)
    ranges[random.random(BEAMS) < 0.02] = np.nan
    return ranges


# What the data sheet of the lidar says. Where it stands on the robot: x, y, heading.
config = Config.model_validate({"lidar": {"sigma_range": 0.01, "mount": (0.0, 0.0, 0.0)}})

warm_up()  # the first time this compiles for half a minute; while driving nothing may wait for that
slam = Slam(config)
random = np.random.default_rng(0)
for step in range(100):
    time = step / RATE
    slam.add(Odometry(time, read_wheels(time)))
    # Offsets from the stamp to each beam straighten what the robot's motion skews; zeros where all beams are at once.
    slam.add(Scan(time, read_lidar(time, random), ANGLES, np.zeros(BEAMS), range_min=0.1, range_max=12.0))
    if step % 25 == 24:
        x, y, heading = slam.pose  # steer by this
        print(f"{time:4.1f} s: at {x:.3f} m, {y:.3f} m, {np.degrees(heading):6.1f} degrees; {len(slam.walls)} walls")

result = slam.finish()
print(f"the room has {len(result.lines)} walls and {len(result.corners)} corners")
