"""A node of ROS 2 over zenoh and over DDS: 40 scans of 1000 beams a second, each of which must be answered in time."""

from __future__ import annotations

import json
import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from drivers.messages import Floats, Odometry, Scan, end_stamp
from drivers.recordings.ros_encoder import BASE_FRAME, ODOMETRY_FRAME, RosEncoder
from drivers.recordings.ros_messages import LASER_SCAN, TRANSFORMS, decode, stamp_of
from drivers.ros2.encoder import GRID, POSE_WITH_COVARIANCE
from drivers.ros2.link import DEFAULT, LATCHED, MOVING_TRANSFORMS, SENSOR_DATA, STATIC_TRANSFORMS, Link
from drivers.ros2.names import NodeNames
from drivers.ros2.selection import Backend, open_link
from drivers.se2 import Pose
from drivers.simulation import LidarModel, Simulation
from drivers.timestamps import to_nanoseconds
from slam.io.output_dir import SUMMARY

from .live_run import END_TIMEOUT, PROGRAM, START_TIMEOUT, Findings, wait_for

BEAMS, RATE = 1000, 40.0
"""Beams of a scan, and scans a second."""
MAX_ROUND_TRIP = 0.015
"""Seconds from sending a scan and the odometry at its end to receiving the pose of that odometry, in 99 % of cases."""
DOMAIN = "94"
LOOPBACK = """<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="lo"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>
<Peers><Peer Address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>"""


def exchange_messages(folder: Path, seconds: int, source: random.Random) -> Iterator[Findings]:
    """Let the node map a simulated office for `seconds` over each link."""
    lidar = LidarModel(beams=BEAMS, rate=RATE)
    drive = [
        message
        for message in Simulation("office", source.randrange(1000), float(seconds), lidar=lidar)
        if isinstance(message, Scan | Odometry)
    ]
    for backend in (Backend.ZENOH, Backend.DDS):
        with _network(backend):
            yield _exchange(folder / backend, backend, drive)


@contextmanager
def _network(backend: Backend) -> Iterator[None]:
    """Set the environment of a network on the loopback interface, with a router if the link needs one."""
    os.environ |= {"ROS_DOMAIN_ID": DOMAIN, "CYCLONEDDS_URI": LOOPBACK}
    os.environ.pop("ROS_DISTRO", None)
    with ExitStack() as router:
        if backend is Backend.ZENOH:
            import zenoh

            with socket.socket() as free:
                free.bind(("127.0.0.1", 0))
                address = json.dumps([f"tcp/127.0.0.1:{free.getsockname()[1]}"])
            os.environ["ZENOH_CONFIG_OVERRIDE"] = f'connect/endpoints={address};listen/endpoints=["tcp/127.0.0.1:0"]'
            config = (
                f'{{mode: "router", listen: {{endpoints: {address}}}, scouting: {{multicast: {{enabled: false}}}}}}'
            )
            router.enter_context(zenoh.open(zenoh.Config.from_json5(config)))
        yield


class _Answers:
    """Times at which poses arrived, by their stamps in nanoseconds."""

    def __init__(self) -> None:
        self.times: dict[int, float] = {}

    def __call__(self, data: bytes) -> None:
        now = time.monotonic()
        self.times.setdefault(round(1e9 * stamp_of(decode(data, POSE_WITH_COVARIANCE, "cdr").header, 0)), now)


def _exchange(out: Path, backend: Backend, drive: list[Scan | Odometry]) -> Findings:
    found, answers = Findings({"link": str(backend)}), _Answers()
    command = [sys.executable, "-c", PROGRAM, "ros", "--link", str(backend), "--out", str(out), "--no-review"]
    with closing(open_link(NodeNames("robot"), backend)) as link, out.with_suffix(".log").open("w") as log:
        link.subscribe("/pose", POSE_WITH_COVARIANCE, DEFAULT, answers)
        begun = time.monotonic()
        node = subprocess.Popen([*command, "-p", f"base_frame:={BASE_FRAME}"], stdout=log, stderr=log)
        sent, scans = _send(link, drive, answers)
        time.sleep(1.0)
        with closing(open_link(NodeNames("late"), backend)) as late:
            maps: list[bytes] = []
            late.subscribe("/map", GRID, LATCHED, maps.append)
            if not wait_for(lambda: maps, 30.0):
                found.failures.append("a late subscriber has no map")
        node.send_signal(signal.SIGINT)
        node.wait(END_TIMEOUT)
    trips = np.array([answers.times[stamp] - at for stamp, at in sent.items() if stamp in answers.times])
    found.figures |= {
        "scans": scans,
        "poses": f"{len(trips)} of {len(sent)}",
        "seconds": round(time.monotonic() - begun),
    }
    if node.returncode or not len(trips):
        found.failures.append(f"ended with {node.returncode}: {out.with_suffix('.log').read_text()[-500:]}")
        return found
    summary = json.loads((out / SUMMARY).read_text())
    found.figures |= dict(
        zip(("median", "p99", "max"), np.quantile(trips, (0.5, 0.99, 1.0)).round(4).tolist(), strict=True)
    )
    found.figures["mapped"] = summary["scans"]
    if len(trips) < len(sent) or summary["scans"] < scans:
        found.failures.append("not every scan was answered")
    if found.figures["p99"] > MAX_ROUND_TRIP:
        found.failures.append("answers come too late")
    return found


def _send(link: Link, drive: list[Scan | Odometry], answers: _Answers) -> tuple[dict[int, float], int]:
    """Send a drive in real time, after the node has answered: each scan with odometry at the end of its sweep.

    Returns when each odometry reading was sent, by its stamp in nanoseconds, and the number of scans.
    """
    encoder = RosEncoder()
    put_scan = link.publish("/scan", LASER_SCAN, SENSOR_DATA)
    put_transform = link.publish("/tf", TRANSFORMS, MOVING_TRANSFORMS)
    scans = [message for message in drive if isinstance(message, Scan)]
    poses = _poses_at(np.array([end_stamp(scan) for scan in scans]), drive)
    mount = scans[0].mount if scans[0].mount is not None else np.zeros(3)
    link.publish("/tf_static", TRANSFORMS, STATIC_TRANSFORMS)(encoder.transform(0.0, BASE_FRAME, "laser", mount))

    def send(scan: Scan, pose: Pose, later: float) -> int:
        nanoseconds = to_nanoseconds(end_stamp(scan) + later)
        put_scan(encoder.scan(replace(scan, stamp=scan.stamp + later), "laser"))
        put_transform(encoder.transform(nanoseconds / 1e9, ODOMETRY_FRAME, BASE_FRAME, pose))
        return nanoseconds

    later, patience = 1000.0, time.monotonic() + START_TIMEOUT
    while not answers.times and time.monotonic() < patience:  # the robot stands
        send(scans[0], poses[0], later)
        later += 1.0 / RATE
        time.sleep(1.0 / RATE)
    sent: dict[int, float] = {}
    begin = time.monotonic()
    for number, (scan, pose) in enumerate(zip(scans, poses, strict=True)):
        time.sleep(max(0.0, begin + number / RATE - time.monotonic()))
        now = time.monotonic()
        sent[send(scan, pose, later)] = now
    return sent, len(scans)


def _poses_at(stamps: Floats, drive: list[Scan | Odometry]) -> Floats:
    """Return the poses (n, 3) of the odometry at stamps (n,)."""
    readings = [message for message in drive if isinstance(message, Odometry)]
    known, poses = [reading.stamp for reading in readings], np.array([reading.pose for reading in readings])
    poses[:, 2] = np.unwrap(poses[:, 2])
    return np.column_stack([np.interp(stamps, known, column) for column in poses.T])
