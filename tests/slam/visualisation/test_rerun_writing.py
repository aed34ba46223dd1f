"""Writing of the review log: it delays no run, loses nothing that matters, and its files are complete."""

from __future__ import annotations

import itertools
import logging
import subprocess
import sys
import threading
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import Chunk, RrdReader

from slam.errors import OutputError
from slam.events import (
    KeyframeAdded,
    LoopDecided,
    Notice,
    ScanTracked,
    StateChanged,
)
from slam.loop_closure.loop_status import LoopStatus
from slam.reporting.log_text import log_losses_text
from slam.visualisation.rerun_log import ReviewLog, review_log, rrd_writer
from slam.visualisation.rerun_log.blueprint import Extent, layout
from slam.visualisation.rerun_log.event_log import EventLog
from slam.visualisation.rerun_log.log_files import log_parts
from slam.visualisation.rerun_log.rrd_reader import ROW_ID, chunks_of
from slam.visualisation.rerun_log.rrd_writer import RrdWriter
from slam.visualisation.rerun_log.shown_area import NO_MAP
from slam.visualisation.rerun_log.viewer import ViewerServer

from ..corridor import Corridor, bare_keyframe, last, log_events, of_kind, rows


def test_closing_twice_is_allowed_and_later_events_are_ignored(tmp_path):
    path = tmp_path / "twice.rrd"
    review = log_events(path, [])
    closed = path.read_bytes()
    review.close()
    review.handle(Notice(0.0, "too late"))
    assert (review.waiting, review.left_out()) == (0, {"thinned": 0, "lost": 0, "failed": 0, "unwritten": 0})
    assert path.read_bytes() == closed


def test_an_unwritable_file_raises_an_output_error(tmp_path):
    with pytest.raises(OutputError, match="review log"):
        ReviewLog(tmp_path / "no such directory" / "review.rrd")


def test_an_error_is_reported_once_and_the_other_events_are_logged(tmp_path, caplog):
    broken = replace(bare_keyframe(0), pose=np.zeros(2))
    with caplog.at_level(logging.ERROR, logger="slam.visualisation.rerun_log"):
        review = log_events(tmp_path / "broken.rrd", [broken, bare_keyframe(1), broken])
        review.close()
    assert review.failures == 2
    assert len(caplog.records) == 1
    assert caplog.messages[0].startswith("broken.rrd is incomplete: 2 events could not be logged (first: KeyframeAdded")
    assert "stalled" not in caplog.text
    assert rows(tmp_path / "broken.rrd", "/world/keyframe/scan", "Points3D:positions") == [(1, [])]


@pytest.mark.parametrize(
    ("left_out", "text"),
    [
        ({"thinned": 0, "lost": 0, "failed": 0, "unwritten": 0}, ""),
        ({"failed": 1}, "incomplete: 1 event that could not be logged"),
        (
            {"thinned": 20, "lost": 3},
            "incomplete: 20 events left out or without points, as logging was slow; 3 events left out, "
            "as logging stalled",
        ),
    ],
)
def test_what_a_log_does_not_contain_is_said_in_words(left_out, text):
    assert log_losses_text(left_out) == text


def stalled(path, monkeypatch) -> tuple[ReviewLog, threading.Event]:
    """Return a log that writes nothing until the event is set."""
    release, write = threading.Event(), EventLog.write
    monkeypatch.setattr(EventLog, "write", lambda log, event: (release.wait(20), write(log, event)))
    return ReviewLog(path), release


def test_a_slow_log_does_not_block_and_keeps_keyframes(tmp_path, monkeypatch):
    review, release = stalled(tmp_path / "slow.rrd", monkeypatch)
    full = replace(bare_keyframe(0), points=np.ones((180, 2)))
    for index in range(700):
        review.handle(ScanTracked(float(index), np.zeros(3), np.zeros(3), 1.0, index))
        review.handle(replace(full, index=index, stamp=float(index)))
    release.set()
    review.close()
    scans = rows(tmp_path / "slow.rrd", "/world/keyframe/scan", "Points3D:positions")
    assert len(scans) == 700
    assert 200 < sum(len(points) == 180 for _, points in scans) < 300
    assert review.thinned > 800
    assert review.left_out() == {"thinned": review.thinned, "lost": 0, "failed": 0, "unwritten": 0}
    assert "left out" in last(tmp_path / "slow.rrd", "/log", "TextLog:text")[0]


def test_a_recording_waits_for_a_slow_log(tmp_path, monkeypatch):
    written = []
    monkeypatch.setattr(EventLog, "write", lambda log, event: (time.sleep(5e-4), written.append(event)))
    review = ReviewLog(tmp_path / "slow.rrd", complete=True)
    for index in range(1500):
        review.handle(ScanTracked(float(index), np.zeros(3), np.zeros(3), 1.0, index))
    review.close()
    assert len(written) == 1500
    assert review.left_out() == {"thinned": 0, "lost": 0, "failed": 0, "unwritten": 0}


def test_a_recording_does_not_wait_for_a_stalled_log(tmp_path, monkeypatch):
    monkeypatch.setattr(review_log, "STALLED_SECONDS", 0.1)
    release = threading.Event()
    monkeypatch.setattr(EventLog, "write", lambda log, event: release.wait(20))
    review = ReviewLog(tmp_path / "stalled.rrd", complete=True)
    for index in range(1000):
        review.handle(ScanTracked(float(index), np.zeros(3), np.zeros(3), 1.0, index))
    release.set()
    review.close()
    assert review.thinned > 400


def test_a_stalled_log_limits_its_memory_and_loses_no_loop_decision(tmp_path, monkeypatch, caplog):
    review, release = stalled(tmp_path / "stalled.rrd", monkeypatch)
    review.handle(bare_keyframe(0))
    for index in range(review_log.STALLED_EVENTS + 1000):
        review.handle(Notice(float(index), "chatter"))
    for number in range(3):
        review.handle(decided(number + 1, LoopStatus.ACCEPTED))
    review.handle(StateChanged(9.0, "LOST", None))
    assert review.waiting < review_log.STALLED_EVENTS + 10
    release.set()
    with caplog.at_level(logging.ERROR, logger="slam.visualisation.rerun_log"):
        review.close()
    assert review.lost == pytest.approx(1000, abs=5)
    assert "stalled" in caplog.text
    found = rows(tmp_path / "stalled.rrd", "/loops/decisions", "loop")
    assert [value for _, value in found] == [[1], [2], [3]]
    assert last(tmp_path / "stalled.rrd", "/localisation_status", "StateChange:state") == ["LOST"]


def decided(candidate: int, status: str) -> LoopDecided:
    return LoopDecided(
        index=0, stamp=float(candidate), candidate=candidate, old=0, motion=np.zeros(3), status=status,
        reason="as it is", overlap_ratio=0.9, matches=5, runner_up=0.1, sigma=0.01, contradicted=0.0,
        merged=(), shift=0.0,
    )  # fmt: skip


def drive_slowly(review: ReviewLog) -> None:
    """Handle the events of a lap with pauses, so that the file grows meanwhile."""
    for number, event in enumerate(Corridor().events()):
        review.handle(event)
        if number % 200 == 0:
            while review.waiting:
                time.sleep(0.01)
            time.sleep(1.2 * rrd_writer.FLUSH_PERIOD)


@pytest.mark.slow
def test_a_long_log_continues_in_files_that_are_readable_by_themselves(tmp_path):
    path = tmp_path / "review.rrd"
    with ReviewLog(path, config="[lidar]", recording="long", part_size=300_000) as review:
        drive_slowly(review)
    files = log_parts(path)
    assert len(files) > 2
    assert files[:2] == (path, tmp_path / "review-2.rrd")
    keyframes = [k for file in files for k, _ in rows(file, "/world/keyframe", "Transform3D:translation")]
    assert keyframes == list(range(len(keyframes)))
    names = {RrdReader(file).recordings()[0].recording_id for file in files}
    assert len(names) == 1  # opened together they are one recording
    for file in files:
        assert "[lidar]" in last(file, "/config", "TextDocument:text")[0]
        assert last(file, "/metrics/counts", "SeriesLines:names") == ["walls", "corners", "keyframes"]


def test_a_server_keeps_at_most_256_megabytes_on_any_computer(tmp_path, monkeypatch):
    limits = []

    def sink(address, port, server_memory_limit):
        limits.append(server_memory_limit)
        return create(address, port, server_memory_limit=server_memory_limit)

    create = rr.GrpcServerSink
    monkeypatch.setattr(rr, "GrpcServerSink", sink)
    with ViewerServer() as server:
        RrdWriter(tmp_path / "review.rrd", layout(Extent(*NO_MAP)), server).close()
    assert [int(limit.removesuffix("MB")) <= 256 for limit in limits] == [True]


@pytest.mark.slow
def test_the_oldest_files_but_the_first_are_deleted(tmp_path, monkeypatch):
    monkeypatch.setattr(rrd_writer, "MAX_PARTS", 3)
    with ReviewLog(tmp_path / "review.rrd", part_size=200_000) as review:
        drive_slowly(review)
    numbers = [
        1 if file.stem == "review" else int(file.stem.split("-")[1]) for file in log_parts(tmp_path / "review.rrd")
    ]
    assert numbers == [1, numbers[-1] - 1, numbers[-1]]


def test_few_rows_are_written_in_chunks_of_their_own(tmp_path, monkeypatch):
    """Each chunk takes memory until the file ends, and a robot drives in familiar places for days."""
    scans, path = 400, tmp_path / "review.rrd"
    ticks = itertools.count()
    clock = SimpleNamespace(monotonic=lambda: 0.1 * next(ticks))  # ten scans a second
    monkeypatch.setattr(rrd_writer, "time", clock)
    with ReviewLog(path) as review:
        for k in range(scans):
            review.handle(ScanTracked(0.1 * k, np.array([0.01 * k, 0.0, 0.0]), np.zeros(3), 1.0, 0))
    chunks = [chunk for chunk in RrdReader(path).stream() if chunk.entity_path == "/world/robot"]
    assert sum(chunk.to_record_batch().num_rows for chunk in chunks) == scans
    assert len(chunks) < scans / 100


def test_keyframes_of_a_recording_are_written_in_fewer_chunks_than_those_of_a_live_run(tmp_path, monkeypatch):
    """A recording is mapped a hundred times as fast as it was driven."""
    chunks = {}
    for complete in (True, False):
        ticks, path = itertools.count(), tmp_path / f"{complete}.rrd"
        clock = SimpleNamespace(monotonic=lambda ticks=ticks: 0.01 * next(ticks))  # some keyframes a second
        monkeypatch.setattr(rrd_writer, "time", clock)
        with ReviewLog(path, complete=complete) as review:
            for k in range(60):
                review.handle(bare_keyframe(k))
        chunks[complete] = [chunk for chunk in moving(path) if chunk.entity_path == "/world/keyframe/scan"]
        assert sum(chunk.to_record_batch().num_rows for chunk in chunks[complete]) == 60
    assert len(chunks[True]) < 0.5 * len(chunks[False])


def test_what_is_logged_with_each_keyframe_is_written_together(tmp_path, monkeypatch):
    """A row that is logged by itself takes ten times as long, and there are twenty of them for each keyframe."""
    monkeypatch.setattr(rrd_writer, "time", SimpleNamespace(monotonic=lambda: 0.0))
    single, log = [], rr.RecordingStream.log
    monkeypatch.setattr(rr.RecordingStream, "log", lambda *args, **kwargs: (single.append(args), log(*args, **kwargs)))
    path, keyframes = tmp_path / "review.rrd", of_kind(Corridor().events(), KeyframeAdded)
    log_events(path, [])
    without = len(single)
    log_events(path, keyframes)
    assert len(rows(path, "/world/keyframe/scan", "Points3D:positions")) == len(keyframes)
    assert len(single) - 2 * without < len(keyframes)


def test_a_keyframe_is_in_the_file_soon_after_it_was_logged(tmp_path):
    """So a killed run has all but the last second, even if nothing follows a keyframe."""
    path = tmp_path / "review.rrd"
    with ReviewLog(path) as review:
        review.handle(bare_keyframe(0))
        end = time.monotonic() + 20.0
        while time.monotonic() < end and not any(c.entity_path == "/world/keyframe/scan" for c in moving(path)):
            time.sleep(0.1)
        assert time.monotonic() < end


def moving(path) -> list[Chunk]:
    """Return the chunks of an unfinished log that are not static."""
    return [chunk for chunk in chunks_of([path]) if not chunk.is_static]


def test_what_is_cleared_does_not_reappear_with_rows_that_were_waiting(tmp_path):
    path = tmp_path / "review.rrd"
    writer = RrdWriter(path, layout(Extent(*NO_MAP)))
    writer.set_time(1.0, 1)
    writer.log_batched("robot/scan", rr.Points3D, positions=np.ones((3, 3)))
    writer.log_batched("robots", rr.Points3D, positions=np.ones((3, 3)))
    writer.clear("robot")
    writer.close()
    (scan,) = [chunk for chunk in chunks_of([path]) if chunk.entity_path == "/robot/scan"]
    (cleared,) = [chunk for chunk in chunks_of([path]) if chunk.entity_path == "/robot"]
    first, second = (chunk.to_record_batch().column(ROW_ID)[0].as_py() for chunk in (scan, cleared))
    assert first < second


def test_the_file_ends_complete_before_the_disk_is_full(tmp_path, monkeypatch, caplog):
    path, events = tmp_path / "review.rrd", list(Corridor().events())
    keyframes = of_kind(events, KeyframeAdded)
    room = iter([*[1e9] * 2, *[1e6] * len(events)])  # free bytes at each look: after rows were written
    monkeypatch.setattr(rrd_writer, "free_space", lambda folder: next(room))
    with ReviewLog(path) as review, caplog.at_level(logging.WARNING):
        for event in events:
            review.handle(event)
    found = [k for k, _ in rows(path, "/world/keyframe", "Transform3D:translation")]
    assert found == list(range(len(found)))
    assert 0 < len(found) < len(keyframes)
    assert (review.failures, review.lost, review.unwritten > len(events) // 2) == (0, 0, True)
    assert [record.message for record in caplog.records] == [
        f"{path.name} ends here, as its disk is nearly full; mapping continues"
    ]


def test_rerun_is_imported_only_when_a_log_is_created():
    code = "import sys, slam, slam.events, slam.visualisation.rerun_log; sys.exit('rerun' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.slow
def test_files_are_also_begun_where_there_are_no_keyframes(tmp_path, monkeypatch):
    monkeypatch.setattr(rrd_writer, "MAX_BATCH_ROWS", 1)
    path, scans = tmp_path / "review.rrd", 400
    with ReviewLog(path, part_size=400_000) as review:
        for k in range(scans):
            review.handle(ScanTracked(0.1 * k, np.array([0.01 * k, 0.0, 0.0]), np.zeros(3), 1.0, 0))
            if k % 100 == 99:
                while review.waiting:
                    time.sleep(0.01)
                time.sleep(1.2 * rrd_writer.FLUSH_PERIOD)
    files = log_parts(path)
    assert len(files) > 1
    assert sum(len(list(rows(file, "/world/robot", "Transform3D:translation"))) for file in files) == scans


@pytest.mark.parametrize("stamps", [(5.0, 1.7e9), (1.7e9, 5.0)])
def test_sensor_times_have_one_type_in_a_log(tmp_path, stamps):
    """A computer without a clock counts from 1970 until it has received the time; so may drives that are merged."""
    path = tmp_path / "review.rrd"
    writer = RrdWriter(path, layout(Extent(*NO_MAP)), max_age=-1.0)  # each row in a chunk of its own
    for number, stamp in enumerate(stamps):
        writer.set_time(stamp, number)
        writer.log("/text", rr.TextDocument(str(number)))
        writer.log_batched("/value", rr.Scalars, scalars=np.array([1.0]))
    writer.close()
    schemas = [chunk.to_record_batch().schema for chunk in chunks_of([path]) if "sensor_time" in chunk.timeline_names]
    assert len({str(schema.field("sensor_time").type) for schema in schemas}) == 1
    assert {chunk.entity_path for chunk in chunks_of([path])} >= {"/text", "/value"}
