"""A run that accepts a loop and retracts it: its state, and loop decisions and residuals in its review log."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.spatial import cKDTree

from drivers import se2
from drivers.simulation import LIDAR_MODELS, WHEEL_MODELS, Simulation
from slam.estimation import closure_monitor
from slam.evaluation.benchmarks.lookalike import MAX_ANGLE_ERROR, MAX_ERROR, MIN_NEEDED_DRIFT
from slam.evaluation.benchmarks.loop_scoring import LoopScorer
from slam.events import Event, EventRecorder, GraphInspected, KeyframeAdded, LoopDecided, MapUpdated
from slam.graph.residuals import CORNER, GAUGE_PRIOR, ODOMETRY, WALL, WALL_EQUALITY
from slam.loop_closure.loop_status import LoopStatus
from slam.pipeline import Slam
from slam.visualisation.rerun_log import ReviewLog
from slam.visualisation.rerun_log.factor_graph_layer import BIN
from slam.visualisation.rerun_log.rrd_reader import Row, chunks_of, rows
from slam.visualisation.rerun_log.shapes import segment_ends

from ..corridor import of_kind

pytestmark = [pytest.mark.slow, pytest.mark.shared_run]

DURATION = 144.0
"""Duration of the drive, seconds: the loop is closed after some 130 s, and retracted 8 s later."""


class Logged(NamedTuple):
    """Log, events and scores of a run that accepted a loop and retracted it, and the pipeline at its end."""

    path: Path
    events: list[Event]
    scorer: LoopScorer
    slam: Slam

    def rows(self, entity: str) -> list[Row]:
        return rows(list(chunks_of([self.path])), entity)


@pytest.fixture(scope="module")
def logged(tmp_path_factory: pytest.TempPathFactory) -> Logged:
    path, listener = tmp_path_factory.mktemp("loops") / "review.rrd", EventRecorder()
    with pytest.MonkeyPatch.context() as patch, ReviewLog(path, complete=True) as review:
        # Every closure is retracted at its first check, some keyframes after acceptance.
        patch.setattr(closure_monitor, "CHECK_INTERVAL", 6.0)
        patch.setattr(closure_monitor, "MAX_ADDED_CONTRADICTION", -1.0)
        patch.setattr(closure_monitor, "CONFIRMING_CHECKS", 1)
        lidar, wheels = replace(LIDAR_MODELS["short"], beams=180, rate=2.0), WHEEL_MODELS["bad"]
        simulation = Simulation("large_loop", seed=0, duration=DURATION, lidar=lidar, wheels=wheels)
        scorer = LoopScorer(simulation)
        slam = Slam(sinks=[listener, review, scorer])
        for message in simulation:
            slam.add(message)
        slam.finish()
    assert review.failures == 0, review.first_failure
    return Logged(path, listener.events, scorer, slam)


def decisions(logged: Logged) -> list[LoopDecided]:
    return [event for event in logged.events if isinstance(event, LoopDecided)]


def test_a_retraction_processes_every_scan_exactly_once(logged: Logged) -> None:
    state, statuses = logged.slam.slam_state, [event.status for event in decisions(logged)]
    assert statuses.count(LoopStatus.RETRACTED) == statuses.count(LoopStatus.ACCEPTED) > 0
    assert np.all(np.diff(state.trajectory.relative_poses()[0]) > 0.0)
    assert np.all(state.mapper.landmarks.walls.rows["last_seen"] < state.mapper.keyframe_count)


def test_needed_loop_is_closed_at_the_right_place(logged: Logged) -> None:
    assert logged.scorer.drift > MIN_NEEDED_DRIFT
    accepted = [decided for decided in logged.scorer.decisions if decided.status == LoopStatus.ACCEPTED]
    assert accepted
    assert max(decided.error for decided in accepted) < MAX_ERROR
    assert max(decided.angle_error for decided in accepted) < MAX_ANGLE_ERROR


def test_a_closed_loop_is_wrong_if_the_final_map_is_bent(logged: Logged) -> None:
    """The loop is closed at the right place, and so is the map then, but later keyframes may bend it."""
    scorer = LoopScorer(Simulation("large_loop", seed=0, duration=DURATION))
    closure = next(k for k, event in enumerate(logged.events) if isinstance(event, LoopDecided))
    for event in logged.events[: closure + 1]:
        if isinstance(event, scorer.handled):
            scorer.handle(event)
    closed = logged.events[closure]
    assert isinstance(closed, LoopDecided)
    assert closed.status is LoopStatus.ACCEPTED
    assert closed.correction is not None
    keyframes = closed.correction.keyframe_poses
    scorer.score_closed(keyframes)
    assert scorer.decisions[0].error < MAX_ERROR
    bent = keyframes.copy()
    bent[closed.index, 0] += 2.0 * MAX_ERROR
    scorer.score_closed(bent)
    assert scorer.decisions[0].error > MAX_ERROR


def test_a_retracted_loop_is_scored_by_its_decision_alone(logged: Logged) -> None:
    """It is open in the final map, which has drifted."""
    before = list(logged.scorer.decisions)
    logged.scorer.score_closed(logged.slam.slam_state.mapper.keyframe_poses + np.array([0.0, 0.0, 1.0]))
    assert logged.scorer.decisions == before


def test_a_late_rejection_is_scored_by_the_pose_that_it_is_about(logged: Logged) -> None:
    rejected = [decided for decided in logged.scorer.decisions if decided.status == LoopStatus.REJECTED]
    assert rejected  # at the end of the drive, for the motion of the closure that was retracted
    assert max(decided.error for decided in rejected) < MAX_ERROR


def test_every_decision_is_a_row_with_its_scores_and_gates(logged: Logged) -> None:
    decided, found = decisions(logged), logged.rows("/loops/decisions")
    assert len(found) == len(decided)
    # Once retracted, the same closure is rejected.
    assert {event.status for event in decided} == {LoopStatus.ACCEPTED, LoopStatus.RETRACTED, LoopStatus.REJECTED}
    for number, (event, row) in enumerate(zip(decided, found, strict=True)):
        value = {name: values[0] for name, values in row.values.items() if values}
        assert (value["number"], value["loop"]) == (number + 1, event.candidate)
        assert (value["status"], value["reason"]) == (event.status, event.reason)
        assert (value["at_keyframe"], value["old_keyframe"]) == (event.index, event.old)
        assert {"support", "span", "contradicted"} <= {test.name for test in event.checks}
        for test in event.checks:
            name = test.name.replace("-", "_")
            assert (value[name], value[f"{name}_gate"]) == (test.value, test.gate)
        assert all(test.passed for test in event.checks) == (event.status != LoopStatus.REJECTED)
        assert value["margin"] == event.margin


def test_a_decision_is_a_step_of_its_timeline(logged: Logged) -> None:
    steps = []
    for chunk in chunks_of([logged.path]):
        if chunk.entity_path == "/loops/decisions" and "candidate" in chunk.timeline_names:
            steps += chunk.to_record_batch().column("candidate").to_pylist()
    assert sorted(steps) == list(range(1, len(decisions(logged)) + 1))


def test_a_correction_shows_the_map_before_it_and_the_shift_of_every_keyframe(logged: Logged) -> None:
    corrected = [event for event in decisions(logged) if event.correction is not None]
    assert [event.status for event in corrected] == [LoopStatus.ACCEPTED, LoopStatus.RETRACTED]
    before, shift = logged.rows("/world/before/walls"), logged.rows("/world/shift")
    assert len(before) == len(shift) == 2
    for event, walls, arrows in zip(corrected, before, shift, strict=True):
        correction = event.correction
        assert correction is not None
        pieces, _ = correction.walls_before.piece_points()
        np.testing.assert_allclose(np.array(walls.values["LineStrips3D:strips"])[..., :2], pieces, atol=1e-3)
        origins, vectors = (np.array(arrows.values[f"Arrows3D:{name}"])[:, :2] for name in ("origins", "vectors"))
        np.testing.assert_allclose(origins, correction.keyframe_poses_before[:, :2], atol=1e-3)
        np.testing.assert_allclose(origins + vectors, correction.keyframe_poses[:, :2], atol=2e-3)
        assert len(arrows.values["Arrows3D:labels"]) == event.index + 1
    accepted, retracted = (event.correction for event in corrected)
    assert accepted is not None
    assert retracted is not None
    assert accepted.shifts().max() > 0.5
    assert (
        accepted.chi2_strained > 10 * accepted.chi2_before
    )  # the added loop contradicts the estimate until that is optimised
    assert accepted.chi2 < 0.1 * accepted.chi2_strained
    # The map is as before the closure, apart from later observations.
    remaining = se2.between(accepted.keyframe_poses_before, retracted.keyframe_poses)
    assert np.hypot(remaining[:, 0], remaining[:, 1]).max() < 0.2 * accepted.shifts().max()


def test_the_map_update_after_a_closure_has_the_path_of_its_correction(logged: Logged) -> None:
    for place, event in enumerate(logged.events):
        if isinstance(event, LoopDecided) and event.status == LoopStatus.ACCEPTED:
            after = next(later for later in logged.events[place:] if isinstance(later, MapUpdated))
            assert event.correction is not None
            np.testing.assert_allclose(after.keyframe_poses, event.correction.keyframe_poses, atol=1e-6)


def test_the_features_of_the_last_keyframe_move_with_a_correction(logged: Logged) -> None:
    shown = {row.keyframe: row.values for row in logged.rows("/world/features/segments")}  # the last row of each
    for event in decisions(logged):
        if event.status == LoopStatus.ACCEPTED and event.correction is not None:
            (seen,) = [one for one in logged.events if isinstance(one, KeyframeAdded) and one.index == event.index]
            ends = segment_ends(seen.segments, event.correction.keyframe_poses[-1])
            np.testing.assert_allclose(np.array(shown[event.index]["LineStrips3D:strips"])[..., :2], ends, atol=1e-3)


def test_compared_points_lie_on_the_old_place_after_alignment(logged: Logged) -> None:
    decided = decisions(logged)
    shown = logged.rows("/compared_points/aligned")
    assert len(shown) == len(decided)
    for event, row in zip(decided, shown, strict=True):
        compared = event.compared
        assert compared is not None
        assert len(row.values["Points3D:positions"]) == len(compared.aligned) == len(compared.recent)
        nearest, _ = cKDTree(compared.old).query(compared.aligned)
        assert np.median(nearest) < 0.05
        assert np.median(cKDTree(compared.old).query(compared.recent)[0]) > 2 * np.median(nearest)


def test_a_retraction_is_in_the_text_log_and_on_the_map(logged: Logged) -> None:
    texts = [(row.keyframe, *row.values["TextLog:level"], *row.values["TextLog:text"]) for row in logged.rows("/log")]
    (retracted,) = [row for row in texts if f" {LoopStatus.RETRACTED}: " in row[2]]
    (accepted,) = [row for row in texts if f" {LoopStatus.ACCEPTED}: " in row[2]]
    assert retracted[1] == "WARN"
    assert retracted[0] > accepted[0]
    (event,) = [event for event in decisions(logged) if event.status == LoopStatus.RETRACTED]
    assert event.reason in retracted[2]
    shown = [(row.keyframe, len(row.values["LineStrips3D:strips"])) for row in logged.rows("/world/loops/accepted")]
    assert [count for keyframe, count in shown if accepted[0] <= keyframe < retracted[0]][-1:] == [1]
    assert shown[-1][1] == 0
    dashes = logged.rows("/world/loops/retracted")[-1].values["LineStrips3D:strips"]
    assert len(dashes) > 1


def test_the_last_decision_is_shown_until_the_next_keyframe(logged: Logged) -> None:
    shown = logged.rows("/world/loops/candidate")
    filled = [bool(row.values["LineStrips3D:strips"]) for row in shown]
    labels = [row.values["LineStrips3D:labels"][0] for row, full in zip(shown, filled, strict=True) if full]
    assert len(labels) == len(decisions(logged))
    assert all(event.status in label for event, label in zip(decisions(logged), labels, strict=True))
    last_of = {type(event): place for place, event in enumerate(logged.events)}
    assert filled[-1] == (last_of[LoopDecided] > last_of[KeyframeAdded])


def test_residuals_have_factor_names_and_are_sorted_worst_first(logged: Logged) -> None:
    inspected = [event for event in logged.events if isinstance(event, GraphInspected)]
    last = inspected[-1].residuals
    assert set(last.kind) >= {ODOMETRY, WALL, CORNER, GAUGE_PRIOR}
    assert any(WALL_EQUALITY in event.residuals.kind for event in inspected)  # while the loop was closed
    keyframes = max(event.index for event in of_kind(logged.events, KeyframeAdded)) + 1
    assert last.is_kind(ODOMETRY).sum() >= keyframes - 5  # a retraction replaces a few
    worst = logged.rows("/residuals/worst")
    assert len(worst) == len(inspected) - sum(not len(event.residuals.worst(1)) for event in inspected)
    squared = np.array(worst[-1].values["squared"]) / np.array(worst[-1].values["dof"])
    assert np.all(np.diff(squared) <= 0)
    measured = ~last.is_kind(GAUGE_PRIOR) & (last.dof > 0)
    assert squared[0] == pytest.approx((last.squared / last.dof)[measured].max())
    assert worst[-1].values["factor"][0] == last.name(int(last.worst(1)[0]))


def test_the_graph_of_a_keyframe_has_the_previous_one_and_the_landmarks_that_it_observes(logged: Logged) -> None:
    keyframes = of_kind(logged.events, KeyframeAdded)
    graphs = [row for row in logged.rows("/graph") if row.values.get("GraphNodes:node_ids")]
    edges = [row for row in logged.rows("/graph") if row.values.get("GraphEdges:edges")]
    drawn = logged.rows("/world/factors/keyframe")
    assert len(graphs) == len(edges) == len(drawn) == len(keyframes)
    seen = 0
    for event, graph, connected, lines in zip(keyframes[1:], graphs[1:], edges[1:], drawn[1:], strict=True):
        walls = {f"L{wall}" for wall in event.wall_match.tolist() if wall >= 0}
        corners = {f"C{corner}" for corner in event.corner_match.tolist() if corner >= 0}
        neighbours = {f"x{event.index - 1}"} | walls | corners
        assert set(graph.values["GraphNodes:node_ids"]) == {f"x{event.index}"} | neighbours
        assert {edge["first"] for edge in connected.values["GraphEdges:edges"]} == {f"x{event.index}"}
        assert {edge["second"] for edge in connected.values["GraphEdges:edges"]} == neighbours
        ends = np.array(lines.values["LineStrips3D:strips"])[..., :2]
        np.testing.assert_allclose(ends[:, 0], np.broadcast_to(event.pose[:2], (len(ends), 2)), atol=1e-3)
        seen += len(walls)
    assert seen > len(keyframes)


def test_only_the_worst_factors_are_drawn_in_the_map(logged: Logged) -> None:
    shown, worst = logged.rows("/world/factors/outliers"), logged.rows("/residuals/worst")
    assert len(shown) == len(worst)
    for row, listed in zip(shown, worst, strict=True):
        names = [label.split(" d²=")[0] for label in row.values["LineStrips3D:labels"] or []]
        assert set(names) <= set(listed.values["factor"])


def test_the_shares_of_the_histogram_of_residuals_add_up(logged: Logged) -> None:
    for name in ("observed", "expected"):
        shares = logged.rows(f"/residuals/histogram/{name}")
        assert len(shares) == len(logged.rows("/residuals/worst"))
        for row in shares:
            (values,) = row.values["BarChart:values"]
            assert sum(values["buffer"]) == pytest.approx(100.0)


def test_observations_of_simulated_walls_deviate_as_expected(logged: Logged) -> None:
    """The noise is as modelled, so both histograms are about equal."""
    observed, expected = (
        np.array(logged.rows(f"/residuals/histogram/{name}")[-1].values["BarChart:values"][0]["buffer"])
        for name in ("observed", "expected")
    )
    below = int(1.0 / BIN)
    assert observed[:below].sum() == pytest.approx(expected[:below].sum(), abs=5.0)


def test_a_step_of_the_closures_shows_everything_right_after_the_correction(logged: Logged) -> None:
    """The timeline ends with the last correction, at which the viewer opens the log, not with the run."""
    corrected = [event for event in decisions(logged) if event.correction is not None]
    shown: dict[str, dict[int, dict[str, Any]]] = {}
    steps = set()
    for chunk in chunks_of([logged.path]):
        if "closure" in chunk.timeline_names:
            assert chunk.timeline_names == ["closure"]
            for row in chunk.to_record_batch().to_pylist():
                steps.add(row["closure"])
                shown.setdefault(chunk.entity_path, {})[row["closure"]] = row
    assert steps == set(range(1, len(corrected) + 1))
    for step, event in enumerate(corrected, start=1):
        after = next(later for later in logged.events[logged.events.index(event) :] if isinstance(later, MapUpdated))
        assert shown["/world/shift"][step]
        x, y, _ = shown["/world/robot"][step]["Transform3D:translation"][0]
        np.testing.assert_allclose([x, y], after.keyframe_poses[-1][:2], atol=1e-3)
        (fit,) = shown["/metrics/chi2"][step]["Scalars:scalars"]
        assert 0.1 < fit < 10.0
        assert shown["/loops/table"][step]["keyframe"] == [event.index]


def test_the_table_of_decisions_has_short_codes_and_rounded_numbers(logged: Logged) -> None:
    codes = {LoopStatus.ACCEPTED: "A", LoopStatus.REJECTED: "R", LoopStatus.RETRACTED: "X"}
    found = logged.rows("/loops/table")
    for event, row in zip(decisions(logged), found, strict=True):
        value = {name: values[0] for name, values in row.values.items() if values}
        assert value["code"].split()[0] == codes[event.status]
        assert (value["keyframe"], value["place"], value["looks"]) == (event.index, event.old, event.matches)
        assert value["shift"] == pytest.approx(event.shift, abs=0.006)
        assert value["overlap"] == pytest.approx(event.overlap_ratio, abs=0.006)
