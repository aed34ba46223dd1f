"""Map a recording, or a simulated drive, and print the longest walls.

python examples/map_a_recording.py intel.clf
python examples/map_a_recording.py "sim:office?duration=60"
"""

import sys

import numpy as np

import drivers
from slam import Slam

recording = sys.argv[1] if len(sys.argv) > 1 else "sim:room?duration=10"

# `drivers.open` returns a source of scans and odometry in time order. `Slam` processes them one by one.
pipeline = Slam()
for message in drivers.open(recording):
    pipeline.add(message)

# The result contains a pose for every stamp of odometry and scans, and walls and corners with covariances.
result = pipeline.finish()
x, y, heading = result.poses[-1]
print(f"{recording}: {len(result.stamps)} poses, the last at {x:.2f} m, {y:.2f} m, {np.degrees(heading):.1f} degrees")

# A wall is a frame with x along the wall, observed from `low` to `high`; its covariance is of (offset across, heading).
lengths = result.walls.high - result.walls.low
for k in np.argsort(-lengths)[:5]:
    across, turn = np.sqrt(np.diag(result.walls.covariance[k]))
    print(
        f"wall {result.walls.identity[k]}: {lengths[k]:.2f} m, standard deviations {1000 * across:.1f} mm across and "
        f"{np.degrees(turn):.2f} degrees, seen from {result.walls.observations[k]} keyframes"
    )
