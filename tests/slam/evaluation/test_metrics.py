import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from drivers import se2
from slam.errors import MapError
from slam.evaluation.metrics import (
    Relations,
    align,
    motion_errors,
    pair_by_time,
    pairs_by_distance,
    read_relations,
    score_reference,
    score_relations,
)
from slam.io.tum import Trajectory, read_tum, write_tum

from ...recordings import recording_file

SHARED = Path(__file__).parents[3].parent / "shared"
SCORER = Path(os.environ.get("WCLM_SCORER", SHARED / "tools" / "score_relations.py"))


def wandering(count: int, seed: int) -> Trajectory:
    generator = np.random.default_rng(seed)
    poses = np.zeros((count, 3))
    for k in range(1, count):
        poses[k] = se2.compose(poses[k - 1], [0.1, 0.0, generator.normal(0, 0.2)])
    return Trajectory(100.0 + 0.1 * np.arange(count), poses)


def noisy(trajectory: Trajectory, seed: int) -> Trajectory:
    noise = np.random.default_rng(seed).normal(0, [0.05, 0.05, 0.02], trajectory.poses.shape)
    return Trajectory(trajectory.stamps, se2.compose(trajectory.poses, noise))


def relations_of(trajectory: Trajectory, count: int, seed: int) -> Relations:
    generator = np.random.default_rng(seed)
    first, second = generator.integers(0, len(trajectory), (2, count))
    motion = se2.between(trajectory.poses[first], trajectory.poses[second])
    return Relations(trajectory.stamps[first], trajectory.stamps[second], motion)


def write_relations(path: Path, relations: Relations) -> None:
    rows = zip(relations.first, relations.second, relations.motion, strict=True)
    path.write_text("".join(f"{a:.6f} {b:.6f} {m[0]:.6f} {m[1]:.6f} 0 0 0 {m[2]:.6f}\n" for a, b, m in rows))


def reference_scores(trajectory: Path, relations: Path) -> dict[str, float]:
    if not SCORER.exists():
        pytest.skip(f"{SCORER} is missing; set WCLM_SCORER to the benchmark's scoring script")
    answer = subprocess.run(
        [sys.executable, str(SCORER), str(trajectory), str(relations), "--json"], capture_output=True, text=True
    )
    return json.loads(answer.stdout)


def test_relations_of_the_trajectory_itself_have_no_error() -> None:
    truth = wandering(300, seed=1)
    figures = score_relations(truth, relations_of(truth, 50, seed=2)).figures()
    assert figures["relations"] == 50
    assert figures["missing"] == figures["interpolated"] == 0
    assert figures["trans_max"] == pytest.approx(0, abs=1e-9)
    assert figures["rot_max"] == pytest.approx(0, abs=1e-6)


def test_a_relation_of_known_error() -> None:
    trajectory = Trajectory(np.array([0.0, 1.0]), np.array([[1, 1, np.pi / 2], [1, 3, np.pi]]))
    relations = Relations(np.array([0.0]), np.array([1.0]), np.array([[1.7, 0.4, np.pi / 2 - 0.1]]))
    score = score_relations(trajectory, relations)
    assert score.errors.translation[0] == pytest.approx(0.5)
    assert score.errors.rotation[0] == pytest.approx(0.1)


def test_relations_outside_the_trajectory_are_counted_and_left_out() -> None:
    truth = wandering(300, seed=3)
    relations = relations_of(truth, 80, seed=4)
    half = Trajectory(truth.stamps[:150], truth.poses[:150])
    inside = (relations.first < 115) & (relations.second < 115)
    score = score_relations(half, relations)
    assert len(score.errors) == inside.sum()
    assert score.missing == 80 - inside.sum()


def test_no_relation_inside_is_an_error() -> None:
    truth = wandering(10, seed=5)
    with pytest.raises(MapError, match="no relation lies within"):
        score_relations(Trajectory(truth.stamps + 1e6, truth.poses), relations_of(truth, 5, seed=6))


@pytest.mark.parametrize("every", [1, 3])
def test_figures_equal_those_of_the_reference_scorer(tmp_path: Path, every: int) -> None:
    truth = wandering(600, seed=7)
    estimate = noisy(truth, seed=8)
    estimate = Trajectory(estimate.stamps[:500:every], estimate.poses[:500:every])
    write_tum(tmp_path / "a.tum", estimate)
    write_relations(tmp_path / "a.relations", relations_of(truth, 400, seed=9))
    ours = score_relations(read_tum(tmp_path / "a.tum"), read_relations(tmp_path / "a.relations")).figures()
    assert ours["missing"] > 0
    assert (ours["interpolated"] > 0) == (every > 1)
    assert ours == reference_scores(tmp_path / "a.tum", tmp_path / "a.relations")


@pytest.mark.parametrize("name", ["intel", "fr079", "csail"])
def test_figures_equal_those_of_the_reference_scorer_on_recordings(name: str) -> None:
    trajectory, relations = (recording_file(name, suffix) for suffix in ("gmapping.tum", "relations"))
    ours = score_relations(read_tum(trajectory), read_relations(relations)).figures()
    assert ours == reference_scores(trajectory, relations)


def test_an_invalid_relation_is_reported_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "a.relations").write_text("1 2 0 0 0 0 0 0\n1 2 3\n")
    with pytest.raises(MapError, match=r"a\.relations:2: expected 8 numbers \(t1 t2 x y z roll pitch yaw\), found 3"):
        read_relations(tmp_path / "a.relations")


def test_alignment_undoes_a_rigid_motion() -> None:
    truth = wandering(200, seed=10)
    moved = se2.compose([3.0, -2.0, 2.5], truth.poses)
    np.testing.assert_allclose(se2.compose(align(moved[:, :2], truth.poses[:, :2]), moved), truth.poses, atol=1e-9)
    score = score_reference(Trajectory(truth.stamps, moved), truth)
    assert score.figures()["ate_rmse"] == pytest.approx(0, abs=1e-6)
    assert score.figures()["rpe_trans_rmse"] == pytest.approx(0, abs=1e-6)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_absolute_and_relative_errors_equal_those_of_evo(tmp_path: Path) -> None:
    from evo.core import metrics, sync
    from evo.tools import file_interface

    truth = wandering(500, seed=11)
    estimate = noisy(truth, seed=12)
    offset = np.random.default_rng(13).uniform(-0.008, 0.008, 250)
    estimate = Trajectory(estimate.stamps[::2] + offset, se2.compose([5, 1, 1], estimate.poses[::2]))
    write_tum(tmp_path / "truth.tum", truth)
    write_tum(tmp_path / "estimate.tum", estimate)
    score = score_reference(read_tum(tmp_path / "estimate.tum"), read_tum(tmp_path / "truth.tum"), step=2.0)

    loaded = [file_interface.read_tum_trajectory_file(str(tmp_path / f"{n}.tum")) for n in ("truth", "estimate")]
    reference, estimated = sync.associate_trajectories(*loaded, max_diff=0.01)
    estimated.align(reference)
    absolute = metrics.APE(metrics.PoseRelation.translation_part)
    absolute.process_data((reference, estimated))
    assert len(score.stamps) == reference.num_poses == 250
    assert score.figures()["ate_rmse"] == pytest.approx(absolute.get_statistic(metrics.StatisticsType.rmse), abs=1e-6)

    errors = [
        metrics.RPE.rpe_base(*(trajectory.poses_se3[k] for trajectory in (reference, estimated) for k in pair))
        for pair in zip(*pairs_by_distance(score.reference[:, :2], 2.0), strict=True)
    ]
    assert len(errors) == len(score.relative) > 100
    np.testing.assert_allclose(score.relative.translation, [np.linalg.norm(e[:3, 3]) for e in errors], atol=1e-6)
    np.testing.assert_allclose(score.relative.rotation, [abs(np.arctan2(e[1, 0], e[0, 0])) for e in errors], atol=1e-6)


def test_poses_of_the_sparser_trajectory_are_paired_within_the_time_tolerance() -> None:
    dense = wandering(100, seed=14)
    sparse = Trajectory(dense.stamps[5::10] + 0.004, dense.poses[5::10])
    far = Trajectory(dense.stamps[5::10] + 0.03, dense.poses[5::10])
    for first, second in ((dense, sparse), (sparse, dense)):
        one, other = pair_by_time(first, second)
        assert len(one) == len(sparse)
        assert np.all(np.abs(first.stamps[one] - second.stamps[other]) < 0.01)
    assert len(pair_by_time(dense, far)[0]) == 0
    with pytest.raises(MapError, match="share 0 times"):
        score_reference(dense, far)


def test_a_path_shorter_than_the_step_has_no_relative_errors() -> None:
    short = wandering(5, seed=15)
    figures = score_reference(short, short, step=10.0).figures()
    assert "rpe_trans_rmse" not in figures


@pytest.mark.parametrize("seed", range(5))
def test_the_trajectory_of_another_drive_is_recognised_by_its_turns(seed: int) -> None:
    drive, other = wandering(400, seed), wandering(400, seed + 100)
    assert score_reference(other, drive).unrelated
    assert score_relations(other, relations_of(drive, 100, seed)).unrelated
    assert not score_reference(noisy(drive, seed), drive).unrelated
    assert not score_relations(noisy(drive, seed), relations_of(drive, 100, seed)).unrelated


def test_a_straight_drive_is_not_taken_for_another_one() -> None:
    stamps, path = np.arange(200.0), np.column_stack([0.1 * np.arange(200), np.zeros((200, 2))])
    drive = Trajectory(stamps, path)
    assert not score_reference(noisy(drive, 1), drive).unrelated


def test_rotation_errors_are_wrapped() -> None:
    errors = motion_errors(np.array([[0, 0, 3.1]]), np.array([[0, 0, -3.1]]))
    assert errors.rotation[0] == pytest.approx(2 * np.pi - 6.2)
