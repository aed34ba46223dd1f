"""A session as it can be gone on from: written into a run's directory, and read back.

All that the estimate consists of is there, not only what came of it: so what reads it back can map on, or look at
everything again, as if the program had never ended.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drivers.messages import Scan

from ...config import Config, load_config
from ...errors import MapError
from ...estimation.refinement import ScanHistory, build_scan_history
from ...estimation.slam_state import SlamState
from ...mapping.keyframes import KeyframeRecords
from ...mapping.landmarks import Landmarks
from ...mapping.mapper import Mapper
from ...mapping.wall_roughness import WallRoughness
from ...odometry.history import OdometryHistory
from ...preprocessing.preprocessor import ProcessedScan
from ..output_dir import CONFIG, SESSION
from .graph import read_factors, read_graph, write_factors, write_variables
from .head import Head, Recording, read_head, write_head
from .landmarks import read_doubts, read_landmarks, write_corners, write_walls
from .scans import UPPER, StoredScans, read_scans, write_recent, write_scans
from .tables import Columns, write_table
from .waiting import read_waiting, write_waiting

HEAD = "session.json"
SIGHTINGS = "scans.parquet"
RECENT = "recent.parquet"
ODOMETRY = "odometry.parquet"
KEYFRAMES = "keyframes.parquet"
WALLS = "walls.parquet"
CORNERS = "corners.parquet"
VARIABLES = "variables.parquet"
FACTORS = "factors.parquet"
CLOSURES = "closures.parquet"
WAITING = "waiting.parquet"
COVARIANCE = ("xx", "xy", "xh", "yy", "yh", "hh")
ADRIFT = {"adrift_xx": (0, 0), "adrift_xy": (0, 1), "adrift_yy": (1, 1)}  # not in tables before version 3
WORDS = ("status", "reason")
COUNTS = ("candidate", "keyframe", "old", "matches", "merged")
SCORES = ("stamp", "overlap_ratio", "runner_up", "sigma", "contradicted", "shift")
"""Of a decision on a place that looked known, besides the motion."""


@dataclass(slots=True, eq=False)
class StoredSession:
    """What a session consists of.

    config       the settings in effect
    belief       the estimate: map, graph, path, and all that was learned
    sightings    every one, in time order
    odometry     all of it, for each drive: a drive ends where odometry does not continue
    starts       rows of the sightings that drives begin with
    recordings   what it was all made of
    closures     every decision on a place that looked known, a row each, as in the summary
    sigma_range  standard deviation of a range as it was estimated last, metres
    waiting      the last scans, for which odometry had not come yet: they are on the path that was told, and not in the
                 estimate, since more odometry may come
    """

    config: Config
    slam_state: SlamState
    scans: Sequence[ProcessedScan]
    odometry: Sequence[OdometryHistory]
    starts: Sequence[int]
    sigma_range: float
    recordings: list[Recording] = field(default_factory=list)
    closures: Sequence[Mapping[str, Any]] = ()
    waiting: Sequence[Scan] = ()

    @property
    def latest(self) -> float:
        """When the last of it was measured, seconds; -inf where nothing was."""
        stamps = [history.latest for history in self.odometry]
        stamps += [scan.stamp for scan in self.scans[-1:]] + [scan.stamp for scan in self.waiting]
        return max(stamps, default=-np.inf)

    def drive(self) -> ScanHistory:
        """All sightings, and where they belong."""
        slam_state = self.slam_state
        return build_scan_history(
            self.scans, slam_state.trajectory, slam_state.keyframe_stamps, slam_state.kidnapped_keyframes, self.starts
        )


def write_stored(directory: Path, stored: StoredSession) -> None:
    """Write a session into the directory of a run, beside its settings. Raises OSError."""
    folder = directory / SESSION
    folder.mkdir()
    slam_state, mapper = stored.slam_state, stored.slam_state.mapper
    graph = mapper.graph.state()
    learned = stored.sigma_range, slam_state.odometry_model.samples, mapper.roughness.samples
    starts, checkpoint, looks = list(stored.starts), slam_state.checkpoint, slam_state.loops.looks
    head = Head.of(stored.recordings, starts, checkpoint, looks, (graph.updates, graph.qr), learned)
    sighted = StoredScans(list(stored.scans), slam_state.trajectory, slam_state.keyframe_stamps, mapper.landmark_ids)
    write_scans(folder / SIGHTINGS, sighted)
    write_recent(folder / RECENT, sighted)
    _write_odometry(folder / ODOMETRY, stored.odometry)
    _write_keyframes(folder / KEYFRAMES, slam_state.keyframe_stamps, mapper.keyframes)
    write_walls(folder / WALLS, mapper.landmarks, mapper.free_space_evidence)
    write_corners(folder / CORNERS, mapper.landmarks)
    write_variables(folder / VARIABLES, graph)
    write_factors(folder / FACTORS, graph.factors, mapper.waiting)
    _write_closures(folder / CLOSURES, stored.closures)
    write_waiting(folder / WAITING, stored.waiting)
    write_head(folder / HEAD, head)


def is_stored(path: Path) -> bool:
    """Whether a run's directory holds what can be gone on from. Those of older versions do not."""
    return (path / SESSION / HEAD).is_file()


def read_stored(path: Path) -> StoredSession:
    """Read the session in the directory of a run. Raises MapError naming the file and what is wrong."""
    if not path.is_dir():
        raise MapError(f"{path}: is not a directory; a session is what `wclm run --out DIR` leaves")
    folder = path / SESSION
    if not is_stored(path):
        raise MapError(f"{path}: holds no {SESSION}/{HEAD}, so it cannot be gone on from; make it again: `wclm run`")
    head = read_head(folder / HEAD)
    config = load_config(path / CONFIG)
    sighted = read_scans(folder / SIGHTINGS, folder / RECENT)
    records = _read_keyframes(folder / KEYFRAMES, sighted, head.version)
    rows = build_scan_history(sighted.scans, sighted.path, sighted.keyframe_stamps, ()).keyframes
    keyframes = {k: sighted.scans[row] for k, row in enumerate(rows.tolist())}
    factors, waiting = read_factors(folder / FACTORS)
    graph = read_graph(folder / VARIABLES, factors, updates=head.graph.updates, qr=head.graph.qr)
    roughness = WallRoughness()
    roughness.take(np.array(head.learned.roughness))
    landmarks = read_landmarks(folder / WALLS, folder / CORNERS, head.version)
    free_space_evidence = read_doubts(folder / WALLS, head.version)
    _check(folder / HEAD, head, sighted, landmarks)
    try:
        segments = [keyframes[k].features.segments for k in range(len(rows))]
        mapper = Mapper.restored(graph, landmarks, roughness, free_space_evidence, records, segments, waiting)
        slam_state = SlamState.restored(
            config.odometry,
            np.array(head.learned.odometry).reshape(-1, 6),
            mapper,
            sighted.path,
            sighted.keyframe_stamps,
            head.checkpoint,
            head.search_state,
            keyframes,
        )
    except (MapError, IndexError, RuntimeError, ValueError) as error:  # tables that do not belong together
        raise MapError(f"{path}: the session cannot be put together: {str(error).splitlines()[0]}") from error
    return StoredSession(
        config=config,
        slam_state=slam_state,
        scans=sighted.scans,
        odometry=_read_odometry(folder / ODOMETRY),
        starts=list(head.starts),
        sigma_range=head.learned.sigma_range,
        recordings=list(head.recordings),
        closures=_read_closures(folder / CLOSURES),
        waiting=read_waiting(folder / WAITING),
    )


def _check(file: Path, head: Head, sighted: StoredScans, landmarks: Landmarks) -> None:
    """Whether what refers to something refers to what is there. Raises MapError."""
    count = len(sighted.keyframe_stamps)
    if head.anchor is not None and head.anchor.keyframe >= count:
        raise MapError(f"{file}: anchor: there is no keyframe {head.anchor.keyframe}")
    if any(not 0 <= keyframe < count for keyframe in head.kidnapped_keyframes):
        raise MapError(f"{file}: carried_keyframes: there are {count} keyframes")
    if any(not 0 <= row <= len(sighted.scans) for row in head.starts):
        raise MapError(f"{file}: starts: there are {len(sighted.scans)} scans")
    walls = max((int(names.walls.max(initial=-1)) for names in sighted.names), default=-1)
    corners = max((int(names.corners.max(initial=-1)) for names in sighted.names), default=-1)
    if walls >= len(landmarks.walls) or corners >= len(landmarks.corners):
        raise MapError(f"{file.with_name(SIGHTINGS)}: a keyframe sees a landmark that is not there")


def _write_odometry(file: Path, drives: Sequence[OdometryHistory]) -> None:
    stamps = np.concatenate([np.zeros(0), *(drive.stamps for drive in drives)])
    poses = np.concatenate([np.zeros((0, 3)), *(drive.poses for drive in drives)])
    drive = np.repeat(np.arange(len(drives), dtype=np.int32), [len(drive) for drive in drives])
    names = ("x", "y", "heading")
    write_table(file, {"drive": drive, "stamp": stamps, **{name: poses[:, k] for k, name in enumerate(names)}})


def _read_odometry(file: Path) -> list[OdometryHistory]:
    table = Columns(file)
    drive, stamps, poses = table.integers("drive"), table.floats("stamp"), table.floats("x", "y", "heading")
    if (np.diff(drive) < 0).any() or (np.diff(stamps) <= 0).any():
        raise MapError(f"{file}: the readings are not in order")
    return [OdometryHistory.of(stamps[drive == number], poses[drive == number]) for number in np.unique(drive).tolist()]


def _write_keyframes(file: Path, stamps: Sequence[float], records: KeyframeRecords) -> None:
    covariances = np.array(records.covariances).reshape(-1, 3, 3)
    upper = covariances[:, UPPER[0], UPPER[1]]
    columns = {"stamp": np.array(stamps)}
    columns |= {name: records.keyframe_poses[:, k] for k, name in enumerate(("x", "y", "heading"))}
    columns["way"] = np.array(records.travelled[: len(stamps)])
    columns |= {name: upper[:, k] for k, name in enumerate(COVARIANCE)}
    columns |= {name: records.correlated_drift[:, *place] for name, place in ADRIFT.items()}
    write_table(file, columns)


def _read_keyframes(file: Path, sighted: StoredScans, version: int) -> KeyframeRecords:
    table = Columns(file)
    if not np.array_equal(table.floats("stamp"), sighted.keyframe_stamps):
        raise MapError(f"{file}: has other keyframes than {SIGHTINGS}")
    upper = table.floats(*COVARIANCE)
    covariances = np.zeros((len(table), 3, 3))
    covariances[:, UPPER[0], UPPER[1]] = covariances[:, UPPER[1], UPPER[0]] = upper
    travelled = table.floats("way").tolist()
    correlated_drift = np.zeros((len(table), 2, 2))
    for name, (row, column) in ADRIFT.items() if version > 2 else ():
        correlated_drift[:, row, column] = correlated_drift[:, column, row] = table.floats(name)
    return KeyframeRecords(
        table.floats("x", "y", "heading"), travelled or [0.0], sighted.names, list(covariances), correlated_drift
    )


def _write_closures(file: Path, closures: Sequence[Mapping[str, Any]]) -> None:
    columns: dict[str, Any] = {name: [str(row[name]) for row in closures] for name in WORDS}
    columns |= {name: np.array([row[name] for row in closures], dtype=np.int32) for name in COUNTS}
    columns |= {name: np.array([row[name] for row in closures], dtype=np.float64) for name in SCORES}
    motions = np.array([row["motion"] for row in closures], dtype=np.float64).reshape(-1, 3)
    columns |= {f"motion_{name}": motions[:, k] for k, name in enumerate(("x", "y", "heading"))}
    write_table(file, columns)


def _read_closures(file: Path) -> list[dict[str, Any]]:
    table = Columns(file)
    columns: dict[str, list[Any]] = {name: table.integers(name).tolist() for name in COUNTS}
    columns |= {name: table.floats(name).tolist() for name in SCORES}
    columns |= {name: table.words(name) for name in WORDS}
    columns["motion"] = table.floats("motion_x", "motion_y", "motion_heading").tolist()
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
