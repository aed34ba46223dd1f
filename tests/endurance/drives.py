"""Live runs with faulty devices, with little processor time, and on a busy computer: nothing else is lost."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.messages import Odometry, Scan
from drivers.realtime import request_realtime_priority
from drivers.recordings.mcap import McapReader
from slam.evaluation.metrics import score_reference
from slam.io.output_dir import SUMMARY, TRAJECTORY
from slam.io.tum import Trajectory, read_tum

from .live_run import END_TIMEOUT, PROGRAM, Findings, LiveRun, emulated, process_tree, send

FAULTS = ("unplug lidar", "stall lidar", "unplug base", "stall base", "restart lidar", "fail lidar", "restart base")
LASTING = ("unplug", "stall")
CORRUPTION = 1e-4 / 3
"""Share of bytes dropped, inserted and flipped each."""
RECONNECTION = 12.0
"""Seconds that a device may take to measure again after a fault: detection, boot, and identification."""
THROTTLE_PERIOD, THROTTLED = 900.0, (300.0, 600.0)
"""Every quarter of an hour, the run gets SHARE of the time between these seconds."""
SHARE, CYCLE = 0.3, 0.1
"""Share of the time, and seconds of a cycle of stopping and continuing all processes."""
SETTLED = 600.0
"""Seconds after which the building is known and memory should not grow."""
MAX_SLOPE = 0.5
"""Megabytes per minute."""
LONGEST_SCAN_GAP, LONGEST_ODOMETRY_GAP = 0.25, 0.1
"""Seconds between messages without a fault."""

LOAD = 8
"""Processes that want the processors."""
PAIRS = (
    ("rplidar-a1", "create2"), ("rplidar-a1-old", "wheels"), ("rplidar-a2", "kobuki"), ("rplidar-a3", "arduino"),
    ("rplidar-c1", "wheels"), ("rplidar-s1", "create2"), ("rplidar-s2", "kobuki"), ("rplidar-s3", "create2"),
    ("ld06", "kobuki"), ("scip", "wheels"),
)  # fmt: skip
PAIR_SECONDS = 30.0
FAULTLESS, FAULTY = (0.010, 0.030), (0.050, 0.3)
"""RMSE and largest error of the path without and with faults, metres after alignment with the true one: while the lidar
is away for ten seconds, only odometry is known of the path.
"""
LOSSES = ("packets_lost", "clock_jumps", "losses", "incomplete_revolutions", "lost", "restarts")
"""Counters that are zero without a fault."""


def drive_with_faults(folder: Path, seconds: int, source: random.Random) -> Iterator[Findings]:
    """Map one room for `seconds` seconds, with a fault every minute or two."""
    found, events = Findings(), _schedule(seconds, source)
    options = [text for kind in ("drop", "insert", "flip") for text in (f"--{kind}", str(CORRUPTION))]
    for at, kind, device, lasting in events:
        options += [f"--{kind}", f"{device}@{at:.0f}" + (f":{lasting:.1f}" if kind in LASTING else "")]
    with emulated(folder, "room", *options) as devices:
        run = LiveRun(folder, devices, "--duration", str(seconds), period=False)
        memory, stops = _watch(run)
        processor = children_seconds()
        if status := run.process.wait(END_TIMEOUT):
            found.failures.append(f"ended with {status}: {run.stderr[-300:]}")
    found.figures |= {"events": len(events), "processor": round(children_seconds() - processor)}
    _check_memory(found, memory)
    report = json.loads((folder / "report.json").read_text())
    begun, not_read = report["begun"], {device: report[device]["overrun"] for device in ("lidar", "base")}
    found.figures |= {"longest_stop": round(max(stops, default=0.0), 3), "not_read": not_read}
    messages = list(McapReader(run.recording))
    measured = {
        "lidar": ([message.stamp for message in messages if isinstance(message, Scan)], LONGEST_SCAN_GAP),
        "base": ([message.stamp for message in messages if isinstance(message, Odometry)], LONGEST_ODOMETRY_GAP),
    }
    for device, (found_stamps, limit) in measured.items():
        stamps = np.array(found_stamps) - begun
        for k in np.flatnonzero(np.diff(stamps) > limit):
            gap = float(stamps[k + 1] - stamps[k])
            causes = [lasting for at, _, of, lasting in events if of == device and -3.0 < stamps[k] - at < RECONNECTION]
            if not causes or gap > causes[0] + RECONNECTION:
                found.failures.append(f"{device}: {gap:.2f} s are missing at {stamps[k]:.1f} s without a fault")
        found.figures[device] = len(stamps)
    if counted := json.loads((run.map / SUMMARY).read_text())["skipped"]["messages"]:
        found.failures.append(f"{counted} messages were not mapped")
    _check_path(found, run, folder / "truth.tum", FAULTY)
    yield found


def _schedule(seconds: int, source: random.Random) -> list[tuple[float, str, str, float]]:
    """Return time, kind, device and duration (seconds) of the faults."""
    events: list[tuple[float, str, str, float]] = []
    at = 90.0
    while at < seconds - 60.0:
        kind, device = FAULTS[len(events) % len(FAULTS)].split()
        events.append((at, kind, device, round(source.uniform(1.0, 6.0), 1) if kind in LASTING else 0.0))
        at += source.uniform(60.0, 120.0)
    return events


def _watch(run: LiveRun) -> tuple[NDArray[np.float64], list[float]]:
    """Slow a run down now and then until it ends.

    Return (n, 2) seconds and resident megabytes, and the seconds for which it was stopped each time.
    """
    rows, stops, begun = [], list[float](), time.monotonic()
    threading.Thread(target=_throttle, args=(run, begun, stops), daemon=True).start()
    while run.process.poll() is None:
        rows.append((time.monotonic() - begun, sum(map(_resident, process_tree(run.process.pid)))))
        time.sleep(5.0)
    return np.array(rows), stops


def _throttle(run: LiveRun, begun: float, stops: list[float]) -> None:
    """Stop and continue all processes of a run so that they get SHARE of the time; add how long each stop lasts."""
    request_realtime_priority()  # on a busy computer the processes would be stopped until this thread has its turn
    while run.process.poll() is None:
        if not THROTTLED[0] < (time.monotonic() - begun) % THROTTLE_PERIOD < THROTTLED[1]:
            time.sleep(1.0)
            continue
        processes, stopped = run.processes(), time.monotonic()
        send(processes, signal.SIGSTOP)
        time.sleep((1.0 - SHARE) * CYCLE)
        send(processes, signal.SIGCONT)
        stops.append(time.monotonic() - stopped)
        time.sleep(SHARE * CYCLE)


def _resident(process: int) -> float:
    """Return the resident memory of a process, megabytes; 0 if it has ended."""
    try:
        return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    except OSError:
        return 0.0


def children_seconds() -> float:
    """Return the processor time of all children that have ended, seconds."""
    times = os.times()
    return times.children_user + times.children_system


def _check_memory(found: Findings, memory: NDArray[np.float64]) -> None:
    settled = memory[(memory[:, 0] > SETTLED) & (memory[:, 0] < memory[-1, 0] - 60.0)]
    found.figures["memory"] = round(memory[:, 1].max())
    if len(settled) < 2:
        return
    slope = float(np.polyfit(settled[:, 0] / 60.0, settled[:, 1], 1)[0])
    found.figures["slope"] = round(slope, 2)
    if slope > MAX_SLOPE:
        found.failures.append(f"memory grows by {slope:.2f} MB a minute")


def _check_path(found: Findings, run: LiveRun, truth: Path, limits: tuple[float, float]) -> None:
    """Check RMSE and largest error of the path (metres), from the first scan on: what was before is odometry's."""
    path = read_tum(run.map / TRAJECTORY)
    first = next(message.stamp for message in McapReader(run.recording) if isinstance(message, Scan))
    mapped = Trajectory(path.stamps[path.stamps >= first], path.poses[path.stamps >= first])
    figures: dict[str, Any] = score_reference(mapped, read_tum(truth)).figures()
    found.figures |= {"rmse": round(figures["ate_rmse"], 4), "max": round(figures["ate_max"], 4)}
    if figures["ate_rmse"] > limits[0] or figures["ate_max"] > limits[1]:
        found.failures.append("the path is wrong")


@contextmanager
def busy_computer() -> Iterator[None]:
    """Let as many processes compute as are missing to LOAD."""
    missing = LOAD - round(os.getloadavg()[0])
    others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(missing)]
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()


def busy_pairs(folder: Path, runs: int, source: random.Random) -> Iterator[Findings]:
    """Map the office with each pair of devices on a busy computer; then map the recording."""
    for lidar, base in PAIRS[:runs]:
        found, place = Findings({"lidar": lidar, "base": base}), folder / f"{lidar}-{base}"
        place.mkdir()
        seed = ("--seed", str(source.randrange(1000)))
        with emulated(place, "office", *seed, lidar=lidar, base=base) as devices, busy_computer():
            run = LiveRun(place, devices, "--duration", str(PAIR_SECONDS), period=False)
            if status := run.process.wait(END_TIMEOUT):
                found.failures.append(f"ended with {status}: {run.stderr[-300:]}")
                yield found
                continue
            found.figures["load"] = round(os.getloadavg()[0], 1)
        for device in json.loads((run.map / SUMMARY).read_text())["devices"]:
            lost = {name: count for name, count in device["counters"].items() if name in LOSSES and count}
            if lost:
                found.failures.append(f"{device['spec']}: {lost}")
        for device in ("lidar", "base"):
            if not_read := json.loads((place / "report.json").read_text())[device]["overrun"]:
                found.failures.append(f"{device}: {not_read} bytes were lost before the program read them")
        _check_path(found, run, place / "truth.tum", FAULTLESS)
        again = place / "again"
        command = [sys.executable, "-c", PROGRAM, "run", str(run.recording), "--out", str(again), "--no-review"]
        subprocess.run(command, capture_output=True, check=True)
        if (again / TRAJECTORY).read_bytes() != (run.map / TRAJECTORY).read_bytes():
            found.failures.append("the recording gives another path")
        yield found
