"""The review log holds what the events said, and a real viewer shows it."""

from __future__ import annotations

import io
import logging
import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rerun.chunk import RrdReader

from drivers import se2
from slam.errors import OutputError
from slam.events import (
    Finished,
    KeyframeAdded,
    LinesMerged,
    MapCorners,
    MapLines,
    MapUpdated,
    Noticed,
    ScanTracked,
    TruthSeen,
)
from slam.review import ReviewLog, colours
from slam.segments import CornerPoints, Segments

# A corridor around a block, 24 m by 16 m outside: wall frames as the robot sees them, from inside the corridor.
OUTER = np.array([[0.0, 0.0], [24.0, 0.0], [24.0, 16.0], [0.0, 16.0]])
INNER = np.array([[3.0, 3.0], [3.0, 13.0], [21.0, 13.0], [21.0, 3.0]])
WAY = np.array([[1.5, 1.5], [22.5, 1.5], [22.5, 14.5], [1.5, 14.5], [1.5, 1.5]])
VULKAN_DRIVERS = (Path("/usr/share/vulkan/icd.d"), Path("/etc/vulkan/icd.d"))
PIECE = 3.0  # metres; walls are split as doors split them
EMPTY_SEGMENTS = Segments(np.empty((0, 3)), np.empty(0), np.empty((0, 2, 2)))


def seen_corners(position: np.ndarray) -> CornerPoints:
    n = len(position)
    return CornerPoints(
        position=position,
        covariance=np.tile(1e-4 * np.eye(2), (n, 1, 1)),
        segments=np.zeros((n, 2), dtype=np.int64),
        headings=np.zeros((n, 2)),
    )


def corridor_walls() -> np.ndarray:
    """(n, 4): x, y, heading of a piece's middle and its half length."""
    walls = []
    for polygon in (OUTER, INNER):
        for start, end in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
            length = np.hypot(*(end - start))
            heading = np.arctan2(*(end - start)[::-1])
            for middle in np.arange(PIECE / 2, length, PIECE):
                share = middle / length
                walls.append([*(start + share * (end - start)), heading, 0.45 * PIECE])
    return np.array(walls)


def drive(step: float, laps: int = 1) -> np.ndarray:
    """(k, 3) true poses along the corridor, turning on the spot at its corners."""
    poses = []
    for start, end in zip(np.tile(WAY[:-1], (laps, 1)), np.tile(WAY[1:], (laps, 1)), strict=True):
        heading = np.arctan2(*(end - start)[::-1])
        for along in np.arange(0.0, np.hypot(*(end - start)), step):
            poses.append([*(start + along * np.array([np.cos(heading), np.sin(heading)])), heading])
    return np.array(poses)


class Corridor:
    """The events of a robot that drives around a corridor: an estimate with a little error, odometry that drifts."""

    def __init__(self, step: float = 0.5, laps: int = 1, start: float = 0.0, beams: int = 180, maps_every: int = 5):
        self.rng = np.random.default_rng(5)
        self.walls = corridor_walls()
        self.truth = drive(step, laps)
        self.start, self.beams, self.maps_every = start, beams, maps_every
        self.world_from_map = self.truth[0]
        self.wall_frames = se2.compose(se2.inverse(self.truth[0]), self.walls[:, :3])
        self.wall_frames[:, 1] += self.rng.normal(0, 0.02, len(self.walls))
        self.seen = np.zeros(len(self.walls), dtype=np.int64)

    def events(self):
        estimates, odometry, drifted = [], np.zeros(3), np.zeros(3)
        for index, truth in enumerate(self.truth):
            stamp = self.start + 0.5 * index
            estimate = se2.between(self.truth[0], truth) + self.rng.normal(0, [0.01, 0.01, 0.002]) * (index > 0)
            motion = se2.between(self.truth[index - 1], truth) if index else np.zeros(3)
            drifted = se2.compose(drifted, motion + np.array([0.0, 0.0, 0.004]))
            odometry = se2.compose(np.array([7.0, -3.0, 1.0]), drifted)
            for part in (0.0, 0.5):
                yield TruthSeen(stamp + part / 2, se2.compose(truth, [0.25 * part, 0, 0]))
                yield ScanTracked(stamp + part / 2, se2.compose(estimate, [0.25 * part, 0, 0]), odometry, 0.9, index)
            estimates.append(estimate)
            yield self.keyframe(index, stamp, truth, estimate, odometry)
            if index == 12:
                yield Noticed(stamp, "no odometry for 1.2 s")
            if index == 20:
                yield LinesMerged(index, stamp, 3, 4, 2.25)
            if index % self.maps_every == 0:
                path = np.array(estimates)
                yield MapUpdated(index, stamp, path, self.lines(), self.corners(), 3.0 * index, 0.3 * (index == 40))
        path, stamps = np.array(estimates), self.start + 0.5 * np.arange(len(estimates))
        summary: dict[str, object] = {"keyframes": len(estimates), "times": {"median": 1.25, "of": "a|b"}}
        yield Finished(self.lines(True), self.corners(), stamps, path, stamps, path, summary)

    def keyframe(self, index, stamp, truth, estimate, odometry):
        local = se2.compose(se2.inverse(truth), self.walls[:, :3])
        near = np.flatnonzero((np.hypot(local[:, 0], local[:, 1]) < 8.0) & (se2.inverse(local)[:, 1] > 0.2))
        new, once = near[self.seen[near] == 0], near[self.seen[near] == 1]
        self.seen[near] += 1
        match = near.copy()
        match[::7] = -1
        gate = np.where((match < 0) | np.isin(near, new), np.nan, self.rng.chisquare(2, len(near)))
        if index > 10:
            gate[match < 0] = 20.5
        frame = local[near] + self.rng.normal(0, [0.01, 0.01, 0.004], (len(near), 3))
        segments = Segments(frame, self.walls[near, 3] * 0.8, np.tile(np.diag([1e-4, 1e-5]), (len(near), 1, 1)))
        corner = se2.transform(se2.inverse(truth), OUTER)
        seen = np.flatnonzero(np.hypot(*corner.T) < 8.0)
        corners = seen_corners(corner[seen] + 0.02)
        spread = 0.01 + 2e-4 * index
        return KeyframeAdded(
            index=index, stamp=stamp, pose=estimate, pose_covariance=np.diag([spread, spread / 2, 0.01]) ** 2,
            odometry=odometry, points=self.scan(local[near], near), segments=segments, corners=corners,
            line_match=match, line_gate=gate, line_nearest=np.where(np.isnan(gate), -1, near),
            corner_match=seen, corner_gate=np.full(len(seen), 1.5), corner_nearest=seen, new_lines=new,
            sigma_range=0.011,
            timings={"features": 1.0 + 0.2 * len(once), "registration": 2.0, "graph": 3.0 + 0.01 * index},
            counts={"walls": int((self.seen > 0).sum()), "corners": len(seen), "factors": 8 * index},
        )  # fmt: skip

    def scan(self, frames, near):
        pick = self.rng.integers(0, len(near), self.beams)
        along = self.rng.uniform(-1, 1, self.beams) * self.walls[near[pick], 3]
        return se2.transform(frames[pick], np.column_stack([along, self.rng.normal(0, 0.01, self.beams)]))

    def lines(self, final=False):
        known = np.flatnonzero(self.seen)
        half = self.walls[known, 3]
        covariance = np.diag([4e-4, 1e-6]) if final else np.full((2, 2), np.nan)
        covariances = np.tile(covariance, (len(known), 1, 1))
        pieces = tuple(np.column_stack([-half, half])[:, None])
        return MapLines(known, self.wall_frames[known], -half, half, self.seen[known], covariances, pieces)

    def corners(self):
        position = se2.transform(se2.inverse(self.truth[0]), OUTER)
        covariance = np.tile(np.array([[0.04, 0.015], [0.015, 0.01]]), (4, 1, 1))
        return MapCorners(np.arange(4), position, covariance, np.array([[0, 1]] * 4), np.full(4, 6))


def rows(path: Path, entity: str, component: str) -> list:
    """What was logged of a component: (keyframe, value) in the order of keyframes; static rows have keyframe None."""
    found = []
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if chunk.entity_path != entity or component not in batch.schema.names:
            continue
        stamped = "keyframe" in batch.schema.names
        keyframes = batch.column("keyframe").to_pylist() if stamped else [None] * batch.num_rows
        found += zip(keyframes, batch.column(component).to_pylist(), strict=True)
    return sorted(found, key=lambda row: (row[0] is not None, row[0]))


def last(path: Path, entity: str, component: str):
    """The value that is seen at the end of the run."""
    return rows(path, entity, component)[-1][1]


@pytest.fixture(scope="module")
def corridor(tmp_path_factory):
    """One lap logged, slowly enough that nothing is left out: the file and the events."""
    path = tmp_path_factory.mktemp("review") / "review.rrd"
    events = list(Corridor().events())
    versions = {"wclm-slam": "0.1.0"}
    with ReviewLog(path, config="[lidar]\nsigma_range = 0.01", recording="corridor", versions=versions) as review:
        for event in events:
            review.handle(event)
            while review.waiting > 50:
                time.sleep(0.001)
    assert (review.failures, review.thinned, review.lost) == (0, 0, 0), review.first_failure
    return path, events


def of_kind(events, kind):
    return [event for event in events if isinstance(event, kind)]


def test_keyframes_hold_pose_and_scan(corridor):
    path, events = corridor
    keyframes = of_kind(events, KeyframeAdded)
    places = rows(path, "/world/keyframe", "Transform3D:translation")
    assert [k for k, _ in places] == [event.index for event in keyframes]
    np.testing.assert_allclose([t[0][:2] for _, t in places], [event.pose[:2] for event in keyframes], atol=1e-5)
    scans = rows(path, "/world/keyframe/scan", "Points3D:positions")
    assert len(scans) == len(keyframes)
    np.testing.assert_allclose(np.array(scans[30][1])[:, :2], keyframes[30].points, atol=1 / 256)


def test_robot_moves_with_every_scan_in_sensor_time_but_not_ahead_of_its_keyframe(corridor):
    path, events = corridor
    robot = [k for k, _ in rows(path, "/world/robot", "Transform3D:translation")]
    assert robot.count(None) == len(of_kind(events, ScanTracked))
    assert [k for k in robot if k is not None] == [event.index for event in of_kind(events, KeyframeAdded)]


def test_features_tell_matched_from_new_and_none(corridor):
    path, events = corridor
    event = of_kind(events, KeyframeAdded)[0]
    colours_seen = rows(path, "/world/features/segments", "LineStrips3D:colors")[0][1]
    labels = rows(path, "/world/features/segments", "LineStrips3D:labels")[0][1]
    assert (len(colours_seen), len(labels)) == (len(event.segments), len(event.segments))
    assert {label.split()[-1] for label in labels} == {"none", "new"}
    later = of_kind(events, KeyframeAdded)[30]
    labels = rows(path, "/world/features/segments", "LineStrips3D:labels")[30][1]
    matched = np.flatnonzero(later.line_match >= 0)[0]
    assert labels[matched] == f"L{later.line_match[matched]} d²={later.line_gate[matched]:.1f}"
    assert "ambiguous d²=20.5" in labels
    gates = rows(path, "/association/lines", "gate")[30][1]
    np.testing.assert_allclose(gates, later.line_gate)


def test_final_map_is_the_last_one_logged(corridor):
    path, events = corridor
    final = events[-1]
    strips = np.array(last(path, "/world/map/walls", "LineStrips3D:strips"))
    np.testing.assert_allclose(strips[..., :2], final.lines.end_points(), atol=1e-3)
    assert last(path, "/world/map/walls", "LineStrips3D:labels")[0] == f"L0 n={final.lines.observations[0]}"
    assert len(last(path, "/world/map/wall_sigma", "LineStrips3D:strips")) == len(final.lines)
    (strip,) = last(path, "/world/path/estimate", "LineStrips3D:strips")
    np.testing.assert_allclose(np.array(strip)[:, :2], final.poses[:, :2], atol=1e-3)
    assert last(path, "/world/path/recent", "LineStrips3D:strips") == []


def test_corner_ellipses_are_three_sigma(corridor):
    path, events = corridor
    half_sizes = np.array(last(path, "/world/map/corner_sigma", "Ellipsoids3D:half_sizes"))
    variances = np.linalg.eigvalsh(events[-1].corners.covariance)
    np.testing.assert_allclose(half_sizes[:, :2], 3 * np.sqrt(variances), rtol=1e-5)
    x, y, z, w = np.array(last(path, "/world/map/corner_sigma", "Ellipsoids3D:quaternions"))[0]
    along = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + z * w)])  # the ellipse's first axis in the map
    shape = events[-1].corners.covariance[0]
    np.testing.assert_allclose(shape @ along, variances[0, 0] * along, atol=1e-6)


def test_true_path_is_laid_over_the_estimate(corridor):
    path, events = corridor
    true_path = np.concatenate(last(path, "/world/truth/0", "LineStrips3D:strips"))[:, :2]
    to_estimate = np.hypot(*(true_path[:, None] - events[-1].poses[None, :, :2]).transpose(2, 0, 1)).min(axis=1)
    assert to_estimate.max() < 0.35  # half a step and the error
    errors = rows(path, "/metrics/error", "Scalars:scalars")
    assert [k for k, _ in errors] == [event.index for event in of_kind(events, KeyframeAdded)]
    assert max(value[0] for _, value in errors) < 6.0  # centimetres


def test_metrics_are_named_and_in_the_units_they_name(corridor):
    path, events = corridor
    keyframes = of_kind(events, KeyframeAdded)
    (_, names), *_ = rows(path, "/metrics/sigma", "SeriesLines:names")
    assert names == ["position [cm]", "heading [°]", "range [cm]"]
    values = dict(rows(path, "/metrics/sigma", "Scalars:scalars"))[30]
    expected = [100 * np.sqrt(keyframes[30].pose_covariance[0, 0]), np.degrees(0.01), 1.1]
    np.testing.assert_allclose(values, expected, rtol=1e-6)
    assert dict(rows(path, "/metrics/counts", "Scalars:scalars"))[30] == list(keyframes[30].counts.values())
    times = dict(rows(path, "/metrics/time", "Scalars:scalars"))[30]
    assert times == [sum(keyframes[30].timings.values()), *keyframes[30].timings.values()]
    assert dict(rows(path, "/metrics/explained", "Scalars:scalars"))[30] == [0.9]
    assert [k for k, _ in rows(path, "/metrics/chi2", "Scalars:scalars")] == list(range(0, 136, 5))


def test_text_and_documents(corridor):
    path, _ = corridor
    assert rows(path, "/log", "TextLog:text") == [
        (12, ["no odometry for 1.2 s"]),
        (20, ["L4 is the same wall as L3: merged, d²=2.2"]),
        (40, ["the path moved by up to 0.30 m"]),
    ]
    assert "sigma_range = 0.01" in last(path, "/config", "TextDocument:text")[0]
    summary = last(path, "/summary", "TextDocument:text")[0]
    assert summary.splitlines()[2:] == ["| keyframes | 136 |", "| times.median | 1.25 |", "| times.of | a\\|b |"]
    assert "Keyframe 30" in rows(path, "/keyframe", "TextDocument:text")[30][1][0]


def test_stamps_since_1970_become_dates(tmp_path):
    log_events(tmp_path / "dates.rrd", Corridor(step=4.0, start=1.0e9).events())
    kinds = {
        str(chunk.to_record_batch().schema.field("sensor_time").type)
        for chunk in RrdReader(tmp_path / "dates.rrd").stream()
        if "sensor_time" in chunk.to_record_batch().schema.names
    }
    assert kinds == {"timestamp[ns]"}


def log_events(path: Path, events) -> ReviewLog:
    with ReviewLog(path) as review:
        for event in events:
            review.handle(event)
    return review


def bare_keyframe(index: int) -> KeyframeAdded:
    nothing, unmatched = np.empty(0), np.empty(0, dtype=np.int64)
    return KeyframeAdded(
        index=index, stamp=float(index), pose=np.zeros(3), pose_covariance=np.full((3, 3), np.nan),
        odometry=np.zeros(3), points=np.empty((0, 2)), segments=EMPTY_SEGMENTS, corners=seen_corners(np.empty((0, 2))),
        line_match=unmatched, line_gate=nothing, line_nearest=unmatched, corner_match=unmatched, corner_gate=nothing,
        corner_nearest=unmatched, new_lines=unmatched,
        sigma_range=0.01, timings={}, counts={},
    )  # fmt: skip


def test_accepts_what_is_empty_or_unknown(tmp_path):
    no_lines = MapLines(np.empty(0, dtype=np.int64), np.empty((0, 3)), np.empty(0), np.empty(0),
                        np.empty(0, dtype=np.int64), np.empty((0, 2, 2)), ())  # fmt: skip
    no_corners = MapCorners(np.empty(0, dtype=np.int64), np.empty((0, 2)), np.empty((0, 2, 2)),
                            np.empty((0, 2), dtype=np.int64), np.empty(0, dtype=np.int64))  # fmt: skip
    events = [
        Noticed(0.0, "a notice before anything else"),
        TruthSeen(0.5, np.zeros(3)),
        ScanTracked(1.0, np.zeros(3), np.zeros(3), float("nan"), 0),
        bare_keyframe(0),
        bare_keyframe(1),
        MapUpdated(1, 1.0, np.empty((0, 3)), no_lines, no_corners, float("nan"), 0.0),
        Finished(no_lines, no_corners, np.empty(0), np.empty((0, 3)), np.empty(0), np.empty((0, 3))),
    ]
    review = log_events(tmp_path / "bare.rrd", events)
    assert review.failures == 0, review.first_failure
    assert rows(tmp_path / "bare.rrd", "/world/keyframe/scan", "Points3D:positions") == [(0, []), (1, [])]


def test_closing_twice_is_fine_and_later_events_are_ignored(tmp_path):
    review = log_events(tmp_path / "twice.rrd", [])
    review.close()
    review.handle(Noticed(0.0, "too late"))


def test_a_file_that_cannot_be_written_is_an_error_of_ours(tmp_path):
    with pytest.raises(OutputError, match="review log"):
        ReviewLog(tmp_path / "no such directory" / "review.rrd")


def test_a_failure_is_reported_once_and_the_rest_is_logged(tmp_path, caplog):
    broken = replace(bare_keyframe(0), pose=np.zeros(2))
    with caplog.at_level(logging.ERROR, logger="slam.review"):
        review = log_events(tmp_path / "broken.rrd", [broken, bare_keyframe(1), broken])
        review.close()
    assert review.failures == 2
    assert len(caplog.records) == 1
    assert "KeyframeAdded" in caplog.text
    assert rows(tmp_path / "broken.rrd", "/world/keyframe/scan", "Points3D:positions") == [(1, [])]


def test_never_waits_and_keeps_keyframes_when_the_log_is_slow(tmp_path, monkeypatch):
    review = ReviewLog(tmp_path / "slow.rrd")
    release, write = threading.Event(), review._log.write
    monkeypatch.setattr(review._log, "write", lambda event: (release.wait(20), write(event)))
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
    assert "left out" in last(tmp_path / "slow.rrd", "/log", "TextLog:text")[0]


def test_rerun_is_imported_only_for_a_log():
    code = "import sys, slam, slam.events, slam.review; sys.exit('rerun' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def viewer():
    """A real viewer without a window. It needs a Vulkan driver; a software one does (mesa-vulkan-drivers)."""
    drivers = [folder for folder in VULKAN_DRIVERS if any(folder.glob("*.json"))]
    if sys.platform == "linux" and not drivers:
        pytest.skip("no Vulkan driver is installed")  # the viewer would come up, and die when it draws
    import rerun_cli
    from rerun.experimental import ViewerClient

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    executable = str(Path(rerun_cli.__file__).with_name("rerun"))
    try:
        client = ViewerClient.spawn(headless=True, port=port, hide_welcome_screen=True, executable_path=executable)
    except Exception as error:  # the viewer's client does not say which errors it raises
        pytest.skip(f"the viewer does not come up, perhaps there is no Vulkan driver: {error}")
    deadline = time.monotonic() + 10
    while True:
        try:
            client.get_state()
            return client
        except Exception as error:
            if time.monotonic() > deadline:
                client.quit()
                pytest.skip(f"the viewer does not come up, perhaps there is no Vulkan driver: {error}")
            time.sleep(0.2)


def loaded(client, path: Path):
    client.open(str(path))
    for _ in range(200):
        state = client.get_state()
        if not state.loading and state.recordings and state.recordings[0].timelines:
            return
        time.sleep(0.1)
    pytest.fail("the viewer does not load the log")


def pixels_of(image: np.ndarray, colour: colours.Colour) -> int:
    return int((np.abs(image.astype(int) - colour[:3]).max(axis=-1) < 40).sum())


def test_a_real_viewer_shows_it(corridor):
    path, _ = corridor
    with viewer() as client:
        loaded(client, path)
        client.set_time(timeline="keyframe", sequence=70, play_state="paused")
        time.sleep(1.5)
        state = client.get_state()
        by_name = {view.name: view.view_id for view in state.views}
        reports = [(view.name, report.summary) for view in state.views for report in view.reports]
        assert reports == []
        assert {"Map", "Close-up of the robot", "Legend", "Log", "Error against the truth"} <= set(by_name)
        picture = client.take_screenshot(by_name["Map"])
        errors = [line.message for line in client.get_logs() if line.level == "ERROR"]
    assert errors == []
    image = np.array(Image.open(io.BytesIO(picture)).convert("RGB"))
    for colour in (colours.WALL, colours.MATCHED, colours.ESTIMATE, colours.CORNER):
        assert pixels_of(image, colour) > 50, colour
