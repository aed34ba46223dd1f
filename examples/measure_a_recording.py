"""Map a recording with one call, measure the rooms, and write a drawing with dimensions.

python examples/measure_a_recording.py intel.clf map.svg
python examples/measure_a_recording.py "sim:office?duration=60" map.svg

In a notebook, the last line of a cell with `mapped` alone shows the map.
"""

import sys
from pathlib import Path

import slam

recording = sys.argv[1] if len(sys.argv) > 1 else "sim:room?duration=10"

# One call reads the recording, maps it, and settles the map.
mapped = slam.run(recording)
print(mapped)

# Standard deviations follow from the joint covariance of all walls: two walls of a room are known better relative to
# each other than each of them in the map.
measurements = mapped.measurements()
for one in measurements:
    if one.kind == "area":
        print(f"room {one.room}: {one.value:.3f} m2, standard deviation {one.sigma:.3f} m2")
    elif one.kind == "width":
        first, second = one.walls
        print(f"walls {first} and {second}: {one.value:.4f} m apart, standard deviation {1000 * one.sigma:.1f} mm")

if len(sys.argv) > 2:
    Path(sys.argv[2]).write_text(mapped.svg(measurements), encoding="utf-8")
