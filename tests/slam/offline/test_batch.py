"""Batches: names of directories, detection of complete results, and crashes of workers."""

from __future__ import annotations

import json
import os
import signal
import socket
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cloudpickle
import pyarrow.parquet as pq
import pytest

from slam.config import load_config
from slam.errors import OutputError, RecordingError
from slam.offline.batch import (
    Job,
    JobOptions,
    Row,
    Status,
    fingerprint,
    make_jobs,
    make_row,
    read_completed_summary,
    remove_leftovers,
    write_table,
)
from slam.offline.batch.cluster import start_local_workers
from slam.offline.batch.dispatch import dispatch

if TYPE_CHECKING:
    from distributed import Client  # takes half a second, also if other tests are collected

PLAIN = JobOptions(load_config(), review=False)
RETRIES = 1


def names(*recordings: str) -> list[str]:
    return [job.name for job in make_jobs(recordings, Path("out"), PLAIN)]


# Directories


def test_a_directory_is_named_after_its_recording() -> None:
    assert names("a/intel.clf", "b/day.clf.gz", "bag", "sim:office?seed=3&duration=2") == [
        "intel",
        "day",
        "bag",
        "sim-office-seed=3-duration=2",
    ]
    job = make_jobs(["a/intel.clf"], Path("out"), PLAIN)[0]
    assert job.recording == str(Path("a/intel.clf").resolve())
    assert job.directory == Path("out/intel").resolve()


def test_recordings_with_the_same_name_get_parts_of_their_paths() -> None:
    found = names("data/monday/drive.mcap", "data/tuesday/drive.mcap", "data/tuesday/other.mcap")
    assert found == ["monday-drive.mcap", "tuesday-drive.mcap", "other"]


def test_a_recording_given_twice_is_mapped_once() -> None:
    assert names("a/../intel.clf", "intel.clf", "sim:room", "sim:room") == ["intel", "sim-room"]


@pytest.mark.parametrize("spec", ["rplidar:/dev/ttyUSB0 + create2:/dev/ttyUSB1", "replay:a.clf?speed=2"])
def test_devices_and_replays_are_refused(spec: str) -> None:
    with pytest.raises(RecordingError, match="is not a recording"):
        names(spec)


def test_recordings_whose_directories_would_have_the_same_name_are_refused() -> None:
    with pytest.raises(RecordingError, match="would have the same directory"):
        names("a-b/drive.clf", "a/b-drive.clf", "a/b/drive.clf")


# Complete results


@pytest.fixture
def job(tmp_path: Path) -> Job:
    (tmp_path / "a.clf").write_text("a recording")
    return make_jobs([str(tmp_path / "a.clf")], tmp_path / "out", PLAIN)[0]


def write_fake_results(job: Job, **values: Any) -> None:
    job.directory.mkdir(parents=True, exist_ok=True)
    for name in job.options.results():
        (job.directory / name).write_text("x")
    summary = {"recording_path": job.recording, "fingerprint": fingerprint(job), **values}
    (job.directory / "summary.json").write_text(json.dumps(summary))


def test_results_are_complete_with_all_files_of_the_same_recording_and_request(job: Job) -> None:
    assert read_completed_summary(job) is None
    write_fake_results(job, scans=3)
    assert (read_completed_summary(job) or {})["scans"] == 3
    (job.directory / "report.html").unlink()
    assert read_completed_summary(job) is None


@pytest.mark.parametrize("change", ["content", "config", "refine", "review log"])
def test_results_of_another_recording_or_request_are_not_complete(job: Job, change: str) -> None:
    write_fake_results(job)
    options = job.options
    if change == "content":
        Path(job.recording).write_text("another recording")
    elif change == "config":
        options = replace(options, config=load_config(None, ["lidar.sigma_range=0.02"]))
    else:
        options = replace(options, refine=change == "refine", review=change == "review log")
    assert read_completed_summary(replace(job, options=options)) is None


def test_change_of_one_file_of_a_bag_changes_the_fingerprint(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    for name in ("metadata.yaml", "a.db3"):
        (tmp_path / "bag" / name).write_text("x")
    job = make_jobs([str(tmp_path / "bag")], tmp_path / "out", PLAIN)[0]
    before = fingerprint(job)
    assert fingerprint(job) == before
    (tmp_path / "bag" / "a.db3").write_text("xx")
    assert fingerprint(job) != before


def test_results_of_another_recording_are_not_replaced(job: Job) -> None:
    write_fake_results(job, recording_path="/elsewhere/a.clf")
    with pytest.raises(OutputError, match=r"contains the results of /elsewhere/a\.clf"):
        read_completed_summary(job)


@pytest.mark.parametrize("content", ["", "[]", "{}", '"text"', "null", '{"recording_path": 3', "\x00"])
def test_directory_with_an_invalid_summary_is_not_complete(job: Job, content: str) -> None:
    write_fake_results(job)
    (job.directory / "summary.json").write_text(content)
    assert read_completed_summary(job) is None


@pytest.mark.parametrize(
    "values",
    [
        {"scans": "x"},
        {"keyframes": [1]},
        {"scans": 1 << 70},
        {"duration": {}},
        {"truth": 5},
        {"slam": [1]},
        {"slam": {"loops": {"accepted": "x"}}},
    ],
    ids=str,
)
def test_results_whose_figures_are_damaged_are_not_complete(job: Job, values: dict[str, Any]) -> None:
    write_fake_results(job, **values)
    assert read_completed_summary(job) is None


def test_leftovers_of_killed_workers_are_removed_and_nothing_else(job: Job) -> None:
    out = job.directory.parent
    for name in (".a-0123abc_", ".a-0123abc_-old", ".a-b-0123abc_", ".a-short", "a", "b", ".ax-0123abc_"):
        (out / name / "deep").mkdir(parents=True)
    remove_leftovers(job)
    assert sorted(path.name for path in out.iterdir()) == [".a-b-0123abc_", ".a-short", ".ax-0123abc_", "a", "b"]


# The table


def test_table_has_a_row_for_every_recording(job: Job, tmp_path: Path) -> None:
    summary = {
        "duration": 60.0,
        "scans": 600,
        "keyframes": 70,
        "wall_seconds": 3.0,
        "peak_memory_mib": 300.0,
        "truth": None,
        "slam": {"loops": {"accepted": 3, "retracted": 1}},
    }
    rows = [
        make_row(job, Status.DONE, summary),
        make_row(job, Status.FAILED, error="why"),
        make_row(replace(job, recording=os.fsdecode(b"b\xfcro.mcap")), Status.WAITING),
    ]
    for _ in range(2):  # the second replaces the first
        write_table(tmp_path / "batch.parquet", rows)
    read = pq.read_table(tmp_path / "batch.parquet").to_pylist()
    assert [row["status"] for row in read] == ["done", "failed", "waiting"]
    assert [row["error"] for row in read] == [None, "why", None]
    assert (read[0]["loops"], read[0]["scans"], read[0]["duration"], read[0]["memory"]) == (2, 600, 60.0, 300.0)
    assert read[1]["scans"] is None
    assert read[2]["recording"] == "b?ro.mcap"


# Workers


@pytest.fixture(scope="module")
def client() -> Iterator[Client]:
    cloudpickle.register_pickle_by_value(sys.modules[__name__])  # workers cannot import the tests
    with start_local_workers(2) as client:
        yield client


def work(job: Job) -> Row:
    """Die, raise or succeed, according to the recording's name; the log counts the tries."""
    with job.log.open("a") as log:
        log.write("try\n")
    tries = len(job.log.read_text().splitlines())
    if job.name.startswith("deadly") or (job.name.startswith("killed-once") and tries == 1):
        os.kill(os.getpid(), signal.SIGKILL)
    if job.name.startswith("broken") or (job.name.startswith("shaky") and tries == 1):
        raise OSError("the disk went away")
    return make_row(job, Status.DONE)


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # from Dask, about the killed worker
def test_crash_of_a_worker_affects_only_its_recording(client: Client, tmp_path: Path) -> None:
    recordings = ["good-1", "deadly", "broken", "good-2", "killed-once", "shaky", *(f"good-{k}" for k in range(3, 9))]
    jobs = make_jobs(recordings, tmp_path, PLAIN)
    (tmp_path / "logs").mkdir()
    statuses: dict[str, list[Status]] = {name: [] for name in recordings}
    errors = {}
    for row in dispatch(jobs, work, client, RETRIES):
        statuses[row.name].append(row.status)
        errors[row.name] = row.error
    for name in recordings:
        end = Status.FAILED if name in ("deadly", "broken") else Status.DONE
        tries = 1 if name.startswith("good") else 2
        assert statuses[name] == [*[Status.RUNNING] * tries, end], name
        # A result that is still in the memory of a killed worker is computed once more.
        assert tries <= len((tmp_path / "logs" / f"{name}.log").read_text().splitlines()) <= tries + 1
    assert errors["deadly"] == "the worker process died while mapping it"
    assert errors["broken"] == "OSError: the disk went away"


def test_local_workers_have_one_thread_and_are_reachable_from_this_computer_only(client: Client) -> None:
    client.wait_for_workers(2, timeout=300)
    info = client.scheduler_info(n_workers=-1)
    assert info["address"].startswith("wclm://127.0.0.1:")
    assert len(info["workers"]) == 2
    for address, worker in info["workers"].items():
        assert address.startswith("wclm://127.0.0.1:")
        assert worker["nthreads"] == 1
    environments = client.run(lambda: {name: os.environ.get(name) for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS")})
    assert all(set(found.values()) == {"1"} for found in environments.values())


@pytest.mark.parametrize("greeting", [b"", b"\0" * 32, b"GET / HTTP/1.1\r\n" * 4])
def test_other_programs_cannot_connect_to_local_workers(client: Client, greeting: bytes) -> None:
    """Neither the scheduler nor a worker says anything to a program that does not know the secret."""
    client.wait_for_workers(2, timeout=300)
    info = client.scheduler_info(n_workers=-1)
    for address in (info["address"], *info["workers"]):
        host, _, port = address.removeprefix("wclm://").partition(":")
        with socket.create_connection((host, int(port)), 10.0) as stream:
            stream.sendall(greeting)
            stream.shutdown(socket.SHUT_WR)
            with suppress(ConnectionResetError):
                assert stream.recv(100) == b""
    assert client.submit(int, "7").result() == 7


def test_each_batch_has_its_own_secret() -> None:
    from slam.offline.batch.private_comm import new_secret

    assert len({new_secret() for _ in range(10)}) == 10
