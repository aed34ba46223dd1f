"""The trajectory of a recording whose stamps were restored has the stamps of the recording."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from slam.io.recorded_stamps import as_read, as_recorded
from slam.io.run_results import read_run_results
from slam.io.sessions import Recording
from slam.io.tum import read_tum_poses

COUNT = 250
TIMES = 976052857_000000 + np.cumsum(np.random.default_rng(2).integers(30_000, 70_000, COUNT))
"""Microseconds of the odometry; each fifth is that of a scan."""
WRITTEN = [f"{time // 1_000_000}.{time % 1_000_000}" for time in TIMES.tolist()]
"""Stamps in the log, without leading zeros of the microseconds."""


def write_log(path: Path) -> None:
    """Write a straight drive through a room of 8 m by 6 m."""
    angles = np.radians(np.arange(-90, 90))
    lines = []
    for k, stamp in enumerate(WRITTEN):
        x = -2.0 + 4.0 * k / COUNT
        if k % 5:
            lines.append(f"ODOM {x:.4f} 0 0 0 0 0 {stamp} host {stamp}\n")
            continue
        ranges = np.minimum((4.0 - x) / np.cos(angles).clip(1e-9), 3.0 / np.abs(np.sin(angles)).clip(1e-9))
        values = " ".join(f"{value:.3f}" for value in ranges)
        lines.append(f"FLASER {len(angles)} {values} {x:.4f} 0 0 {x:.4f} 0 0 {stamp} host {stamp}\n")
    path.write_text("".join(lines))


def stamps_of(out: str) -> list[float]:
    return read_tum_poses(Path(out, "trajectory.tum"))[0].tolist()


def test_trajectory_has_the_recorded_stamps_and_results_are_read_with_the_restored_ones(
    wclm: Any, tmp_path: Path
) -> None:
    write_log(tmp_path / "log.clf")
    recorded = [float(stamp) for stamp in WRITTEN]
    assert min(np.diff(recorded)) < 0.0
    assert wclm("run", "log.clf", "--out", "out", "--no-review").exit_code == 0
    assert stamps_of("out") == recorded
    path = read_run_results(Path("out")).trajectory
    np.testing.assert_allclose(path.stamps, TIMES / 1e6, rtol=0, atol=1e-6)
    assert min(np.diff(path.poses[:, 0])) > 0.0

    assert wclm("optimize", "out", "--out", "refined", "--no-review").exit_code == 0
    assert stamps_of("refined") == recorded

    own = ("eval", "out/trajectory.tum", "--reference", "out/trajectory.tum", "--json")
    assert json.loads(wclm(*own).stdout)["ate_rmse"] < 1e-6


def test_stamps_of_pins_are_those_of_the_trajectory_and_times_are_counted_from_its_start(
    wclm: Any, tmp_path: Path
) -> None:
    write_log(tmp_path / "log.clf")
    assert wclm("run", "log.clf", "--out", "out", "--no-review").exit_code == 0
    stamps, poses = read_tum_poses(Path("out", "trajectory.tum"))
    restored = np.flatnonzero(np.abs(stamps - TIMES / 1e6) > 0.1)[1:-1]
    rows = [f"pose,{stamps[k]:.6f},{poses[k, 0]},{poses[k, 1]},0.002\n" for k in restored]
    (tmp_path / "pins.csv").write_text("kind,id,x,y,sigma\n" + "".join(rows))
    result = wclm("correct", "out", "--pins", "pins.csv", "--out", "pinned")
    assert result.exit_code == 0, result.output
    (outcome,) = read_run_results(Path("pinned")).summary["corrections"]
    assert max(pin["before"] for pin in outcome["pins"]) < 0.005

    late = f"{TIMES[0] / 1e6 + 5400.0:.12g} s: there is no keyframe"
    wclm.refuses("correct", "out", "--close", "0:01,90:00", because=[late])


def test_stamps_of_each_recording_of_a_session_are_replaced() -> None:
    recording = Recording(name="a", path=None, first=5.0, last=6.0, recorded_stamps={5.081719: 5.81719})
    later = recording.model_copy(update={"shift": 10.0, "recorded_stamps": {5.012345: 5.12345}})
    summary = json.loads(json.dumps({"recordings": [recording.model_dump(), later.model_dump()]}))
    stamps = np.array([5.012345, 5.081719, 5.1, 15.012345, 15.081719])
    recorded = as_recorded(stamps, summary)
    np.testing.assert_allclose(recorded, [5.012345, 5.81719, 5.1, 15.12345, 15.081719], rtol=0, atol=1e-9)
    np.testing.assert_allclose(as_read(recorded, summary), stamps, rtol=0, atol=1e-9)
    assert as_recorded(stamps, {}) is stamps


def test_recording_without_restored_stamps_has_no_list_of_them() -> None:
    usual = Recording(name="a", path=None, first=0.0, last=1.0)
    assert usual.model_dump(mode="json") == {"name": "a", "path": None, "shift": 0.0, "first": 0.0, "last": 1.0}
    restored = usual.model_copy(update={"recorded_stamps": {5.081719: 5.81719}})
    assert Recording.model_validate_json(restored.model_dump_json()) == restored
