"""Many recordings on a few workers: names, what is complete, what a killed worker costs, and who is blamed for it."""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cloudpickle
import pyarrow.parquet as pq
import pytest
from distributed import Client

from slam.config import load_config
from slam.errors import OutputError, RecordingError
from slam.offline.batch import (
    Job,
    Request,
    Row,
    Status,
    completed,
    fingerprint,
    jobs_for,
    remove_leftovers,
    row_of,
    write_table,
)
from slam.offline.batch.cluster import local_workers
from slam.offline.batch.dispatch import dispatch

PLAIN = Request(load_config(), review=False)
RETRIES = 1


def names(*recordings: str) -> list[str]:
    return [job.name for job in jobs_for(recordings, Path("out"), PLAIN)]


# Directories


def test_a_directory_is_named_after_its_recording() -> None:
    assert names("a/intel.clf", "b/day.clf.gz", "bag", "sim:office?seed=3&duration=2") == [
        "intel",
        "day",
        "bag",
        "sim-office-seed=3-duration=2",
    ]
    job = jobs_for(["a/intel.clf"], Path("out"), PLAIN)[0]
    assert job.recording == str(Path("a/intel.clf").resolve())
    assert job.directory == Path("out/intel").resolve()


def test_recordings_of_one_name_are_told_apart_by_their_paths() -> None:
    found = names("data/monday/drive.mcap", "data/tuesday/drive.mcap", "data/tuesday/other.mcap")
    assert found == ["monday-drive.mcap", "tuesday-drive.mcap", "other"]


def test_a_recording_given_twice_is_mapped_once() -> None:
    assert names("a/../intel.clf", "intel.clf", "sim:room", "sim:room") == ["intel", "sim-room"]


@pytest.mark.parametrize("spec", ["rplidar:/dev/ttyUSB0 + create2:/dev/ttyUSB1", "replay:a.clf?speed=2"])
def test_what_cannot_be_read_twice_is_refused(spec: str) -> None:
    with pytest.raises(RecordingError, match="is no recording"):
        names(spec)


def test_recordings_that_no_name_tells_apart_are_refused() -> None:
    with pytest.raises(RecordingError, match="would have the same directory"):
        names("a-b/drive.clf", "a/b-drive.clf", "a/b/drive.clf")


# What is complete


@pytest.fixture
def job(tmp_path: Path) -> Job:
    (tmp_path / "a.clf").write_text("a recording")
    return jobs_for([str(tmp_path / "a.clf")], tmp_path / "out", PLAIN)[0]


def pretend_mapped(job: Job, **summary: Any) -> None:
    job.directory.mkdir(parents=True, exist_ok=True)
    for name in job.request.results():
        (job.directory / name).write_text("x")
    told = {"recording_path": job.recording, "fingerprint": fingerprint(job), **summary}
    (job.directory / "summary.json").write_text(json.dumps(told))


def test_results_are_complete_with_all_files_of_the_same_recording_and_request(job: Job) -> None:
    assert completed(job) is None
    pretend_mapped(job, scans=3)
    assert (completed(job) or {})["scans"] == 3
    (job.directory / "report.html").unlink()
    assert completed(job) is None


@pytest.mark.parametrize("change", ["content", "config", "refine", "log wanted"])
def test_what_was_made_otherwise_is_not_complete(job: Job, change: str) -> None:
    pretend_mapped(job)
    request = job.request
    if change == "content":
        Path(job.recording).write_text("another recording")
    elif change == "config":
        request = replace(request, config=load_config(None, ["lidar.sigma_range=0.02"]))
    else:
        request = replace(request, refine=change == "refine", review=change == "log wanted")
    assert completed(replace(job, request=request)) is None


def test_a_change_of_one_file_of_a_bag_shows(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    for name in ("metadata.yaml", "a.db3"):
        (tmp_path / "bag" / name).write_text("x")
    job = jobs_for([str(tmp_path / "bag")], tmp_path / "out", PLAIN)[0]
    before = fingerprint(job)
    assert fingerprint(job) == before
    (tmp_path / "bag" / "a.db3").write_text("xx")
    assert fingerprint(job) != before


def test_results_of_another_recording_are_not_replaced(job: Job) -> None:
    pretend_mapped(job, recording_path="/elsewhere/a.clf")
    with pytest.raises(OutputError, match=r"holds the results of /elsewhere/a\.clf"):
        completed(job)


@pytest.mark.parametrize("content", ["", "[]", "{}", '"text"', "null", '{"recording_path": 3', "\x00"])
def test_a_summary_of_whatever_is_not_complete(job: Job, content: str) -> None:
    pretend_mapped(job)
    (job.directory / "summary.json").write_text(content)
    assert completed(job) is None


def test_leftovers_of_killed_workers_are_removed_and_nothing_else(job: Job) -> None:
    out = job.directory.parent
    for name in (".a-0123abc_", ".a-0123abc_-old", ".a-b-0123abc_", ".a-short", "a", "b", ".ax-0123abc_"):
        (out / name / "deep").mkdir(parents=True)
    remove_leftovers(job)
    assert sorted(path.name for path in out.iterdir()) == [".a-b-0123abc_", ".a-short", ".ax-0123abc_", "a", "b"]


# The table


def test_the_table_tells_of_every_recording(job: Job, tmp_path: Path) -> None:
    summary = {
        "duration": 60.0,
        "scans": 600,
        "keyframes": 70,
        "wall_seconds": 3.0,
        "peak_memory_mib": 300.0,
        "truth": None,
        "slam": {"loops": {"accepted": 3, "retracted": 1}},
    }
    rows = [row_of(job, Status.DONE, summary), row_of(job, Status.FAILED, error="why"), row_of(job, Status.WAITING)]
    for _ in range(2):  # replaces the older one
        write_table(tmp_path / "batch.parquet", rows)
    read = pq.read_table(tmp_path / "batch.parquet").to_pylist()
    assert [row["status"] for row in read] == ["done", "failed", "waiting"]
    assert [row["error"] for row in read] == [None, "why", None]
    assert (read[0]["loops"], read[0]["scans"], read[0]["duration"], read[0]["memory"]) == (2, 600, 60.0, 300.0)
    assert read[1]["scans"] is None


# Workers


@pytest.fixture(scope="module")
def client() -> Iterator[Client]:
    cloudpickle.register_pickle_by_value(sys.modules[__name__])  # workers cannot import the tests
    with local_workers(2) as client:
        yield client


def work(job: Job) -> Row:
    """Does what the recording's name says; tries are counted in the log."""
    with job.log.open("a") as log:
        log.write("try\n")
    tries = len(job.log.read_text().splitlines())
    if job.name.startswith("deadly") or (job.name.startswith("killed-once") and tries == 1):
        os.kill(os.getpid(), signal.SIGKILL)
    if job.name.startswith("broken") or (job.name.startswith("shaky") and tries == 1):
        raise OSError("the disk went away")
    return row_of(job, Status.DONE)


@pytest.mark.filterwarnings("default")  # of the machinery around a worker that is killed
def test_a_worker_that_dies_takes_nothing_with_it(client: Client, tmp_path: Path) -> None:
    recordings = ["good-1", "deadly", "broken", "good-2", "killed-once", "shaky", *(f"good-{k}" for k in range(3, 9))]
    jobs = jobs_for(recordings, tmp_path, PLAIN)
    (tmp_path / "logs").mkdir()
    told: dict[str, list[Status]] = {name: [] for name in recordings}
    errors = {}
    for row in dispatch(jobs, work, client, RETRIES):
        told[row.name].append(row.status)
        errors[row.name] = row.error
    for name in recordings:
        end = Status.FAILED if name in ("deadly", "broken") else Status.DONE
        tries = 1 if name.startswith("good") else 2
        assert told[name] == [*[Status.RUNNING] * tries, end], name
        assert len((tmp_path / "logs" / f"{name}.log").read_text().splitlines()) == tries
    assert errors["deadly"] == "the worker dies of it"
    assert errors["broken"] == "OSError: the disk went away"


def test_workers_have_one_thread_and_are_reached_from_here_only(client: Client) -> None:
    client.wait_for_workers(2, timeout=30)
    told = client.scheduler_info(n_workers=-1)
    assert told["address"].startswith("tcp://127.0.0.1:")
    assert len(told["workers"]) == 2
    for address, worker in told["workers"].items():
        assert address.startswith("tcp://127.0.0.1:")
        assert worker["nthreads"] == 1
    environments = client.run(lambda: {name: os.environ.get(name) for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS")})
    assert all(set(found.values()) == {"1"} for found in environments.values())
