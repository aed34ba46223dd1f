"""Program with zenoh-ros2-sdk, which has its own encoding of keys, hashes and attachments: the other side of a link.

Arguments: a directory for message definitions, and the first range of the scans to send. It prints the
cells of the map on /map, and the response of the service, sends scans until standard input ends, and ends.
"""

from __future__ import annotations

import os
import sys
import threading
import traceback
from pathlib import Path

import numpy as np
from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk import ROS2Publisher, ROS2ServiceClient, ROS2Subscriber
from zenoh_ros2_sdk.message_registry import get_registry
from zenoh_ros2_sdk.qos import QosDurability, QosProfile

SCAN, MAP, RESET = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/OccupancyGrid", "slam_toolbox/srv/Reset"
PERIOD = 0.1
"""Seconds between two scans."""
ATTEMPTS = 20
"""Subscriptions to /map: the SDK asks for a latched message once, for at most 2 s, which a busy machine may exceed."""


def write_definitions(folder: Path) -> None:
    """Write the definitions of all types of ROS as files, which the SDK would fetch over the network."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name in store.fielddefs:
        text = store.generate_msgdef(name, ros_version=2)[0].partition("=" * 80)[0]
        file = folder / f"{name}.msg"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    get_registry().messages_dir = folder


def main(folder: Path, first: float) -> None:
    write_definitions(folder)
    arrived = threading.Event()

    def show(message: object) -> None:
        if not arrived.is_set():
            print("map", message.data.tolist(), flush=True)
        arrived.set()

    latched = QosProfile(durability=QosDurability.TRANSIENT_LOCAL)
    for _ in range(ATTEMPTS):
        subscriber = ROS2Subscriber("/map", MAP, show, qos=latched)
        if arrived.wait(3.0):
            break
        subscriber.close()
    else:
        raise TimeoutError("no map")
    scans = ROS2Publisher("/scan", SCAN)
    request, response = "bool pause_new_measurements", "uint8 result"
    client = ROS2ServiceClient("/slam_toolbox/reset", RESET, request, response, timeout=60.0)
    print("result", client.call(pause_new_measurements=True).result, flush=True)
    types = scans.session_mgr.store.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](7, 8), "laser")
    ranges = np.array([first, 2.0, 3.0], dtype=np.float32)
    ended = threading.Thread(target=sys.stdin.read, daemon=True)
    ended.start()
    while ended.is_alive():
        scans.publish(
            header=header, angle_min=-1.0, angle_max=1.0, angle_increment=1.0, time_increment=0.0, scan_time=0.0,
            range_min=0.1, range_max=9.0, ranges=ranges, intensities=ranges[:0],
        )  # fmt: skip
        ended.join(PERIOD)
    subscriber.close()


if __name__ == "__main__":
    status = 1
    try:
        main(Path(sys.argv[1]), float(sys.argv[2]))
        status = 0
    except Exception:
        traceback.print_exc()
    finally:
        os._exit(status)  # threads of the SDK would keep the process alive after an error
