"""`wclm batch` with worker processes: results equal those of `wclm run`, also after failures and interruptions."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from datetime import datetime
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from ..robot import children_cpu_seconds

WCLM = """
import signal
from slam.cli import main
if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # SIGINT is ignored in the background of a shell
    main()
"""
SHORT = ("sim:room?duration=3&lidar=short", "sim:room?duration=4&lidar=short")
NAMES = ("sim-room-duration=3-lidar=short", "sim-room-duration=4-lidar=short")


def table(out: Path) -> dict[str, dict[str, Any]]:
    # A file opened by name is opened twice, and the command may replace it in between.
    content = pa.BufferReader((out / "batch.parquet").read_bytes())
    return {row["name"]: row for row in pq.read_table(content).to_pylist()}


def unfinished(out: Path) -> list[Path]:
    return list(out.glob(".*"))


def test_batch_maps_valid_recordings_and_keeps_complete_results(wclm: Any, tmp_path: Path) -> None:
    out = tmp_path / "out"
    (tmp_path / "garbage.clf").write_bytes(bytes(range(256)) * 8)
    batch = ("batch", *SHORT, "garbage.clf", "missing.mcap", "--out", "out", "--no-review", "--workers", 1)
    result = wclm(*batch)
    assert result.exit_code == 1, result.output
    assert "Traceback" not in result.output
    found = table(out)
    assert {name: row["status"] for name, row in found.items()} == {
        NAMES[0]: "done",
        NAMES[1]: "done",
        "garbage": "failed",
        "missing": "failed",
    }
    assert re.search(r"sim-room-duration=3-lidar=short +done +3\.0 s +\d+ m +16 ", result.stdout)
    assert "missing: failed: " in result.stdout
    assert "no such file" in found["missing"]["error"]
    assert "no such file" in Path(found["missing"]["log"]).read_text()
    assert (found[NAMES[0]]["scans"], found[NAMES[0]]["error_rmse"] < 0.01) == (16, True)
    assert 50 < found[NAMES[0]]["memory"] < 2000
    assert not unfinished(out)

    assert wclm("run", SHORT[0], "--out", "alone", "--no-review").exit_code == 0
    for name in ("trajectory.tum", "map.json"):
        assert (out / NAMES[0] / name).read_bytes() == (tmp_path / "alone" / name).read_bytes()

    before = (out / NAMES[0] / "summary.json").stat()
    result = wclm("batch", *SHORT, "--out", "out", "--no-review")
    assert result.exit_code == 0, result.output
    assert {row["status"] for row in table(out).values()} == {"kept"}
    assert (out / NAMES[0] / "summary.json").stat() == before


def test_invalid_arguments_are_one_line_errors(wclm: Any, tmp_path: Path) -> None:
    wclm.refuses("batch", "rplidar:/dev/ttyUSB0", "--out", "out", because=["is not a recording"])
    wclm.refuses("batch", *SHORT, "--out", "out", "--set", "lidar.x=1", because=["lidar.x"])
    (tmp_path / "file").write_text("x")
    wclm.refuses("batch", *SHORT, "--out", "file", because=["file: cannot be created"])
    wclm.refuses("batch", *SHORT, "--out", "out", "--scheduler", "nowhere", because=["nowhere: no Dask scheduler"])
    both = wclm("batch", *SHORT, "--out", "out", "--scheduler", "tcp://127.0.0.1:1", "--workers", 2)
    assert both.exit_code == 2


@pytest.mark.slow
def test_an_interrupted_batch_keeps_only_complete_results(tmp_path: Path) -> None:
    out = tmp_path / "out"
    recordings = [SHORT[0], "sim:office?duration=300", "sim:office?duration=301"]
    process = start_batch(tmp_path, recordings, "out", 2)
    deadline = time.monotonic() + 200  # includes compilation
    while len(unfinished(out)) < 2 or table(out)[NAMES[0]]["status"] != "done":
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.05)
    assert table(out)["sim-office-duration=300"]["status"] == "running"
    os.killpg(process.pid, signal.SIGINT)  # as in a terminal, to the workers as well
    printed, messages = process.communicate(timeout=60)
    assert process.returncode == 130, messages
    assert "interrupted; 1 of 3 recordings are complete" in messages
    assert "Traceback" not in messages
    assert printed == ""
    assert [row["status"] for row in table(out).values()] == ["done", "waiting", "waiting"]
    assert not unfinished(out)
    assert not (out / "sim-office-duration=300").exists()


@pytest.mark.slow
def test_two_workers_are_nearly_twice_as_fast_and_a_killed_one_is_replaced(tmp_path: Path) -> None:
    recordings = [f"sim:office?seed={seed}&duration=60" for seed in range(24)]
    concurrency, cpu_seconds = {}, {}
    for workers in (1, 2):
        cpu_before = children_cpu_seconds()
        process = start_batch(tmp_path, recordings, f"with-{workers}", workers)
        assert wait_for_end(process, 1000) == 0
        cpu_seconds[workers] = children_cpu_seconds() - cpu_before
        rows = table(tmp_path / f"with-{workers}").values()
        concurrency[workers] = sum(row["seconds"] for row in rows) / elapsed_seconds([Path(row["log"]) for row in rows])
    # Together these make two workers faster by the same factor, but on a busy computer they hold as well.
    assert concurrency[2] / concurrency[1] >= 1.7, concurrency
    assert cpu_seconds[2] / cpu_seconds[1] <= 1.25, cpu_seconds

    out = tmp_path / "killed"
    process = start_batch(tmp_path, recordings[:4], "killed", 2)
    log = out / "logs" / "sim-office-seed=0-duration=60.log"
    while not list(out.glob(".sim-office-seed=0*")):
        assert process.poll() is None
        time.sleep(0.05)
    found = re.search(r"process (\d+)", log.read_text())
    assert found is not None
    os.kill(int(found[1]), signal.SIGKILL)
    assert wait_for_end(process, 200) == 0
    assert {row["status"] for row in table(out).values()} == {"done"}
    assert log.read_text().count("started by process") == 2
    assert not unfinished(out)
    for name in ("trajectory.tum", "map.json"):
        same = [tmp_path / made / "sim-office-seed=0-duration=60" / name for made in ("with-1", "with-2", "killed")]
        assert len({path.read_bytes() for path in same}) == 1


def elapsed_seconds(logs: list[Path]) -> float:
    """Return the time from the first line of the first log to the last line of the last one, seconds."""
    first_lines = [log.read_text().partition(" started by")[0] for log in logs]
    started = min(datetime.strptime(line, "%Y-%m-%d %H:%M:%S").timestamp() for line in first_lines)
    return max(log.stat().st_mtime for log in logs) - started


def start_batch(directory: Path, recordings: list[str], out: str, workers: int) -> subprocess.Popen[str]:
    """Start the command in a process and a process group of its own."""
    (directory / "wclm.py").write_text(WCLM)
    options = ["--out", out, "--no-review", "--workers", str(workers)]
    return subprocess.Popen(
        [sys.executable, "wclm.py", "batch", *recordings, *options],
        cwd=directory,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def wait_for_end(process: subprocess.Popen[str], timeout: float) -> int:
    process.communicate(timeout=timeout)
    return process.returncode
