"""Long tests of live runs on an emulated robot, and of the node of ROS 2: `python -m tests.endurance --help`.

kill    the run is killed at random moments
power   the power of its disk fails at random moments (root)
disk    its disk becomes full (root)
faults  for an hour devices are unplugged, fall silent, restart and fail, bytes are damaged, processors have no time
ros     a node of ROS 2 over zenoh and DDS, 40 scans of 1000 beams a second for five minutes each
grid    the occupancy grid of two hours of exploring
pairs   ten pairs of lidar and base while other programs keep the processors busy
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from .crashes import full_disks, kill_runs, power_failures
from .drives import busy_pairs, drive_with_faults
from .large_grid import explore
from .live_run import Findings
from .ros_exchange import exchange_messages

Test = Callable[[Path, int, random.Random], Iterator[Findings]]
TESTS: dict[str, tuple[Test, int]] = {
    "kill": (kill_runs, 100),
    "power": (power_failures, 20),
    "disk": (full_disks, 20),
    "faults": (drive_with_faults, 3600),
    "ros": (exchange_messages, 300),
    "grid": (explore, 7200),
    "pairs": (busy_pairs, 10),
}
"""Function of each test, and its usual size: runs, or seconds of `faults`, `ros` and `grid`."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("test", choices=TESTS)
    parser.add_argument("--size", type=int, help="number of runs; of `faults`, `ros` and `grid`, seconds")
    parser.add_argument("--seed", type=int, default=1, help="of the random moments (default: %(default)s)")
    parser.add_argument("--keep", type=Path, help="empty directory for all files; by default a temporary one")
    arguments = parser.parse_args()
    test, size = TESTS[arguments.test]
    failed = count = 0
    with tempfile.TemporaryDirectory(prefix="wclm-endurance-") as folder:
        place = (arguments.keep or Path(folder)).resolve()
        place.mkdir(parents=True, exist_ok=True)
        for found in test(place, arguments.size or size, random.Random(arguments.seed)):
            print(
                count, json.dumps(found.figures), *found.failures, sep="\n    " if found.failures else "  ", flush=True
            )
            count, failed = count + 1, failed + bool(found.failures)
    print(f"{arguments.test}: {failed} of {count} runs failed")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
