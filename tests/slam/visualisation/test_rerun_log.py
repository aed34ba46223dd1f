"""The review log contains the content of the events."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import RrdReader
from scipy.spatial import cKDTree

from drivers import se2
from slam.events import (
    Finished,
    GroundTruthReceived,
    KeyframeAdded,
    MapUpdated,
    Notice,
    Relocalised,
    ScanTracked,
    StateChanged,
    SuspectFound,
)
from slam.io.exports.confidence import wall_stretches
from slam.mapping.map_features import Keyframes, MapCorners, MapWalls
from slam.visualisation.rerun_log import colours, rrd_writer
from slam.visualisation.rerun_log.event_log import EventLog

from ..corridor import Corridor, bare_keyframe, last, log_events, of_kind, rows


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


def test_feature_labels_distinguish_matched_new_and_rejected(corridor):
    path, events = corridor
    event = of_kind(events, KeyframeAdded)[0]
    colours_seen = rows(path, "/world/features/segments", "LineStrips3D:colors")[0][1]
    labels = rows(path, "/world/features/segments", "LineStrips3D:labels")[0][1]
    assert (len(colours_seen), len(labels)) == (len(event.segments), len(event.segments))
    assert {label.split()[-1] for label in labels} == {"none", "new"}
    later = of_kind(events, KeyframeAdded)[30]
    labels = rows(path, "/world/features/segments", "LineStrips3D:labels")[30][1]
    matched = np.flatnonzero(later.wall_match >= 0)[0]
    assert labels[matched] == f"L{later.wall_match[matched]} d²={later.wall_gate[matched]:.1f}"
    rejected = np.flatnonzero((later.wall_match < 0) & (later.wall_nearest >= 0))
    assert len(rejected) > 1
    assert all(labels[k] == f"not L{later.wall_nearest[k]} d²=20.5" for k in rejected)
    links = dict(rows(path, "/world/features/gated_out", "LineStrips3D:strips"))[30]
    assert len(links) == len(rejected)


def test_final_map_is_the_last_one_logged(corridor):
    path, events = corridor
    final = events[-1]
    strips = np.array(last(path, "/world/map/walls", "LineStrips3D:strips"))
    np.testing.assert_allclose(strips[..., :2], final.walls.end_points(), atol=1e-3)
    assert last(path, "/world/map/walls", "LineStrips3D:labels")[0] == f"L0 n={final.walls.observations[0]}"
    assert len(last(path, "/world/map/wall_sigma", "LineStrips3D:strips")) == len(final.walls)
    (strip,) = last(path, "/world/path/estimate", "LineStrips3D:strips")
    np.testing.assert_allclose(np.array(strip)[:, :2], final.poses[:, :2], atol=1e-3)
    assert last(path, "/world/path/recent", "LineStrips3D:strips") == []


def test_the_grid_of_the_final_map_is_one_picture_that_is_free_along_the_path(corridor):
    path, events = corridor
    keyframe, format_of = rows(path, "/world/grid", "GridMap:format")[-1]
    assert len(rows(path, "/world/grid", "GridMap:format")) == 1
    assert keyframe == of_kind(events, KeyframeAdded)[-1].index
    size = last(path, "/world/grid", "GridMap:cell_size")[0]
    corner = np.array(last(path, "/world/grid", "GridMap:translation")[0])[:2]
    columns, lines = format_of[0]["width"], format_of[0]["height"]
    data = np.asarray(last(path, "/world/grid", "GridMap:data")[0], dtype=np.uint8)
    picture = data.reshape(lines, columns, 3)[::-1]
    cells = np.floor((events[-1].keyframes.poses[:, :2] - corner) / size).astype(int)
    free = (picture[cells[:, 1], cells[:, 0]] == colours.FREE).all(axis=1)
    assert free.mean() > 0.9
    occupied = np.argwhere((picture == colours.OCCUPIED).all(axis=2))[:, ::-1]
    scans = [se2.transform(event.pose, event.points) for event in of_kind(events, KeyframeAdded)]
    gaps = cKDTree(np.concatenate(scans)).query(corner + size * (occupied + 0.5))[0]
    assert len(occupied) > 50
    assert gaps.max() < 1.5 * size


def test_the_confidence_map_is_that_of_the_report(tmp_path):
    path, events = tmp_path / "confidence.rrd", list(Corridor(step=4.0).events())
    finished = events[-1]
    variances = np.linspace(0.0, 0.5, len(finished.keyframes)) ** 2
    events[-1] = replace(
        finished, keyframes=replace(finished.keyframes, covariance=variances[:, None, None] * np.eye(3))
    )
    log_events(path, events)
    stretches = wall_stretches(finished.walls)
    weak = last(path, "/world/confidence/weak", "Points3D:labels")
    assert any("m of the path are known to" in label for label in weak)
    strips = np.array(last(path, "/world/confidence/walls", "LineStrips3D:strips"))
    np.testing.assert_allclose(strips[..., :2], [one.points for one in stretches], atol=1e-3)
    labels = last(path, "/world/confidence/walls", "LineStrips3D:labels")
    assert [int(label.split(":")[0][1:]) for label in labels] == [one.identity for one in stretches]
    shown = last(path, "/world/confidence/walls", "LineStrips3D:colors")
    packed = [(r << 24) + (g << 16) + (b << 8) + 255 for r, g, b in colours.CONFIDENCE]
    assert shown == [packed[one.level] for one in stretches]


def test_corner_ellipses_are_three_sigma(corridor):
    path, events = corridor
    half_sizes = np.array(last(path, "/world/map/corner_sigma", "Ellipsoids3D:half_sizes"))
    variances = np.linalg.eigvalsh(events[-1].corners.covariance)
    np.testing.assert_allclose(half_sizes[:, :2], 3 * np.sqrt(variances), rtol=1e-5)
    x, y, z, w = np.array(last(path, "/world/map/corner_sigma", "Ellipsoids3D:quaternions"))[0]
    along = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + z * w)])  # the ellipse's first axis in the map
    shape = events[-1].corners.covariance[0]
    np.testing.assert_allclose(shape @ along, variances[0, 0] * along, atol=1e-6)


def test_ellipses_that_would_cover_walls_are_left_out_and_labels_state_their_sigma(tmp_path):
    events = list(Corridor(step=8.0).events())
    finished = events[-1]
    wide = finished.corners.covariance.copy()
    wide[1] *= 4.0
    events[-1] = replace(finished, corners=replace(finished.corners, covariance=wide))
    log_events(tmp_path / "wide.rrd", events)
    assert len(last(tmp_path / "wide.rrd", "/world/map/corner_sigma", "Ellipsoids3D:half_sizes")) == 3
    labels = last(tmp_path / "wide.rrd", "/world/map/corners", "Points3D:labels")
    sigmas = np.sqrt(np.linalg.eigvalsh(wide)[:, -1])
    assert [label.split("σ=")[1] for label in labels] == [f"{100 * sigma:.0f} cm" for sigma in sigmas]


def test_scans_of_earlier_keyframes_move_with_the_map(tmp_path):
    events = list(Corridor(step=2.0).events())
    finished = events[-1]
    shift = np.array([0.0, 3.0, 0.0])
    events.append(replace(finished, keyframes=replace(finished.keyframes, poses=finished.keyframes.poses + shift)))
    path = tmp_path / "scans.rrd"
    log_events(path, events)
    keyframes = of_kind(events, KeyframeAdded)
    index = keyframes[-1].index
    assert index > 20
    recent = np.array(last(path, f"/world/last_scans/{index % 5}", "Points3D:positions"))[:, :2]
    drawn = np.array(last(path, "/world/scans/0", "Points3D:positions"))[:, :2]
    expected = [se2.transform(event.pose, event.points) + shift[:2] for event in keyframes]
    assert cKDTree(expected[index]).query(recent)[0].max() < 0.01
    assert cKDTree(np.concatenate(expected[:20])).query(drawn)[0].max() < 0.01
    assert cKDTree(drawn).query(np.concatenate(expected[:20]))[0].max() < 0.3  # thinned


def test_true_path_is_aligned_with_the_estimate(corridor):
    path, events = corridor
    true_path = np.concatenate(last(path, "/world/truth/0", "LineStrips3D:strips"))[:, :2]
    to_estimate = np.hypot(*(true_path[:, None] - events[-1].poses[None, :, :2]).transpose(2, 0, 1)).min(axis=1)
    assert to_estimate.max() < 0.35  # half a step plus the error
    errors = rows(path, "/metrics/error", "Scalars:scalars")
    assert [k for k, _ in errors] == [event.index for event in of_kind(events, KeyframeAdded)]
    assert max(value[0] for _, value in errors) < 6.0  # centimetres


def test_time_series_have_names_and_units(corridor):
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
    assert dict(rows(path, "/metrics/overlap_ratio", "Scalars:scalars"))[30] == [0.9]
    assert [k for k, _ in rows(path, "/metrics/chi2", "Scalars:scalars")] == list(range(0, 136, 5))
    assert dict(rows(path, "/metrics/time/1", "Scalars:scalars")) == {20: [7.0], 40: [8.0]}  # a stage that appears late


def test_text_log_and_documents_have_the_events_texts(corridor):
    path, events = corridor
    finished = events[-1]
    counts = f"{len(finished.keyframes)} keyframes, {len(finished.walls)} walls, {len(finished.corners)} corners"
    assert rows(path, "/log", "TextLog:text") == [
        (12, ["no odometry for 1.2 s"]),
        (20, ["L4 merged into L3, d²=2.2"]),
        (40, ["the path moved by up to 0.30 m"]),
        (135, [f"finished: {counts}"]),
    ]
    assert "sigma_range = 0.01" in last(path, "/config", "TextDocument:text")[0]
    summary = last(path, "/summary", "TextDocument:text")[0]
    assert summary.splitlines()[2:] == ["| keyframes | 136 |", "| times.median | 1.25 |", "| times.of | a\\|b |"]
    assert "Keyframe 30" in rows(path, "/keyframe", "TextDocument:text")[30][1][0]


def test_stamps_since_1970_are_logged_as_dates(tmp_path):
    log_events(tmp_path / "dates.rrd", Corridor(step=4.0, start=1.0e9).events())
    kinds = {
        str(chunk.to_record_batch().schema.field("sensor_time").type)
        for chunk in RrdReader(tmp_path / "dates.rrd").stream()
        if "sensor_time" in chunk.to_record_batch().schema.names
    }
    assert kinds == {"timestamp[ns]"}


def test_empty_and_unknown_values_are_accepted(tmp_path):
    no_lines = MapWalls(np.empty(0, dtype=np.int64), np.empty((0, 3)), np.empty(0), np.empty(0),
                        np.empty(0, dtype=np.int64), np.empty((0, 2, 2)), ())  # fmt: skip
    no_corners = MapCorners(np.empty(0, dtype=np.int64), np.empty((0, 2)), np.empty((0, 2, 2)),
                            np.empty((0, 2), dtype=np.int64), np.empty(0, dtype=np.int64))  # fmt: skip
    no_keyframes = Keyframes.without_covariance(np.empty(0), np.empty((0, 3)))
    events = [
        Notice(0.0, "a notice before anything else"),
        GroundTruthReceived(0.5, np.zeros(3)),
        ScanTracked(1.0, np.zeros(3), np.zeros(3), float("nan"), 0),
        bare_keyframe(0),
        bare_keyframe(1),
        MapUpdated(1, 1.0, np.empty((0, 3)), no_lines, no_corners, float("nan"), 0.0),
        Finished(no_lines, no_corners, no_keyframes, np.empty(0), np.empty((0, 3))),
    ]
    review = log_events(tmp_path / "bare.rrd", events)
    assert review.failures == 0, review.first_failure
    assert rows(tmp_path / "bare.rrd", "/world/keyframe/scan", "Points3D:positions") == [(0, []), (1, [])]


def test_equal_notices_of_a_keyframe_are_logged_once(tmp_path):
    slip, gap = (lambda stamp, text=text: Notice(stamp, text) for text in ("slipped", "a gap"))
    events = [bare_keyframe(0), slip(0.1), slip(0.2), gap(0.3), slip(0.4), bare_keyframe(1), slip(1.1), slip(1.2)]
    log_events(tmp_path / "log.rrd", events)
    texts = [(index, text[0]) for index, text in rows(tmp_path / "log.rrd", "/log", "TextLog:text")]
    assert texts == [(0, "slipped"), (0, "a gap"), (0, "slipped"), (1, "slipped")]


def test_a_keyframe_that_is_in_the_map_no_more_is_cleared(tmp_path):
    no_lines = MapWalls(np.empty(0, dtype=np.int64), np.empty((0, 3)), np.empty(0), np.empty(0),
                        np.empty(0, dtype=np.int64), np.empty((0, 2, 2)), ())  # fmt: skip
    no_corners = MapCorners(np.empty(0, dtype=np.int64), np.empty((0, 2)), np.empty((0, 2, 2)),
                            np.empty((0, 2), dtype=np.int64), np.empty(0, dtype=np.int64))  # fmt: skip
    scan = replace(bare_keyframe(2), points=np.ones((5, 2)))
    kept, dropped = ([scan, MapUpdated(2, 2.0, np.zeros((left, 3)), no_lines, no_corners, 1.0, 0.0)] for left in (3, 2))
    for events, cleared in ((kept, []), (dropped, [(2, [True])])):
        path = tmp_path / f"{bool(cleared)}.rrd"
        assert log_events(path, events).failures == 0
        assert rows(path, "/world/features", "Clear:is_recursive") == cleared


def test_suspects_are_marked_and_named_from_their_own_time_on(tmp_path):
    events = [bare_keyframe(0), bare_keyframe(1), SuspectFound(1, 1.0, "at 0:01: the map", np.array([3.0, 4.0]))]
    events.append(SuspectFound(0, 0.0, "at 0:00: odometry", np.array([5.0, 6.0])))
    log_events(tmp_path / "log.rrd", events)
    marks = [rows(tmp_path / "log.rrd", f"/world/suspects/{k}", "Points3D:positions") for k in (0, 1)]
    assert [[(keyframe, position[0][:2]) for keyframe, position in rows_of] for rows_of in marks] == [
        [(1, [3.0, 4.0])],
        [(0, [5.0, 6.0])],
    ]
    texts = [text[0] for _, text in rows(tmp_path / "log.rrd", "/log", "TextLog:text")]
    assert texts == ["SUSPECT at 0:00: odometry", "SUSPECT at 0:01: the map"]


def test_a_relocalisation_is_in_the_text_log_and_its_pose_in_the_map(tmp_path):
    path, pose = tmp_path / "relocalised.rrd", np.array([4.0, -2.0, np.pi / 2])
    events = [
        bare_keyframe(0),
        bare_keyframe(1),
        StateChanged(1.2, "LOST", None),
        Relocalised(1.5, np.zeros(3), 3),
        Relocalised(1.7, pose, 5),
    ]
    review = log_events(path, events)
    assert review.failures == 0, review.first_failure
    texts = dict(zip(last_levels(path), [text for _, (text,) in rows(path, "/log", "TextLog:text")], strict=True))
    assert texts["INFO"] == "relocalised in the map at (4.00, -2.00) m, 90°"
    outlines = last(path, "/world/relocalisations", "LineStrips3D:strips")
    assert len(outlines) == 2
    np.testing.assert_allclose(np.array(outlines[1])[0, :2], [4.0, -1.7], atol=1e-3)  # the tip of the arrow
    assert last(path, "/world/relocalisations", "LineStrips3D:labels")[-1] == "relocalised after x1"
    (robot,) = last_between_keyframes(path, "/world/robot", "Transform3D:translation")
    np.testing.assert_allclose(robot[:2], pose[:2])


def test_every_event_has_a_case_in_the_log(tmp_path):
    log = EventLog(tmp_path / "unknown.rrd", "", "", {})
    with pytest.raises(AssertionError, match="unreachable"):
        log.write(object())  # type: ignore[arg-type]
    log.close()


def last_levels(path) -> list[str]:
    return [level for _, (level,) in rows(path, "/log", "TextLog:level")]


def last_between_keyframes(path, entity: str, component: str):
    """Return the last value of an entity that has no keyframe."""
    return [value for keyframe, value in rows(path, entity, component) if keyframe is None][-1]


def test_a_step_repeats_the_last_texts_only(tmp_path, monkeypatch):
    """Notices come for days without a loop decision."""
    monkeypatch.setattr(rrd_writer, "MAX_STEP_TEXTS", 3)
    path = tmp_path / "review.rrd"
    writer = rrd_writer.RrdWriter(path, rrb.Blueprint())
    for k in range(7):
        writer.set_time(0.1 * k, 0)
        writer.log("log", rr.TextLog(f"notice {k}"))
    writer.log_step(rrd_writer.CANDIDATE, 1)
    writer.close()
    batches = [chunk.to_record_batch() for chunk in RrdReader(path).stream() if chunk.entity_path == "/log"]
    steps = [batch for batch in batches if rrd_writer.CANDIDATE in batch.schema.names]
    texts = [text for batch in steps for text in batch.column("TextLog:text").to_pylist()]
    assert texts == [["notice 4"], ["notice 5"], ["notice 6"]]


def test_rows_at_the_end_of_a_log_without_keyframes_are_stamped_like_its_scans(tmp_path):
    path, start = tmp_path / "localised.rrd", 1.7e9
    found = Corridor(step=4.0, start=start).events()
    events = [event for event in found if isinstance(event, ScanTracked | MapUpdated | Finished)]
    log_events(path, events)
    batches = [chunk.to_record_batch() for chunk in RrdReader(path).stream()]
    stamps = [batch.column("sensor_time") for batch in batches if "sensor_time" in batch.schema.names]
    assert {str(column.type) for column in stamps} == {"timestamp[ns]"}
    assert max(column.to_numpy().max() for column in stamps) == np.datetime64(int(1e9 * events[-2].stamp), "ns")
