"""Write a complete session into the directory of a run, and read it back.

A session holds everything the estimate consists of, not only its results. A run continued from it gives the same
estimate as an uninterrupted one, and the whole session can be refined.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...config import Config, load_config
from ...errors import MapError, first_line
from ...estimation.refinement import build_scan_history
from ...estimation.slam_state import SlamState
from ...graph.graph_storage import graph_state
from ...mapping.keyframes import KeyframeRecords
from ...mapping.landmarks import Landmarks
from ...mapping.mapper import Mapper
from ...preprocessing.scan_sequence import ScanSequence
from ..output_dir import CONFIG, SESSION, require_results
from ..stored_session import StoredSession
from .agreement import agreement_state
from .graph import read_factors, read_graph, write_factors, write_variables
from .header import SessionHeader, read_header, write_header
from .header_references import check_header
from .keyframes import read_keyframes, write_keyframes
from .landmarks import read_free_space_evidence, read_landmarks, write_corners, write_walls
from .loop_decisions import read_loop_decisions, write_loop_decisions
from .odometry import read_odometry, write_odometry
from .queued_scans import read_queued_scans, write_queued_scans
from .references import check_drift, check_factors, check_landmark_ids, check_landmarks, check_variables
from .scans import ScanRecords, read_scans, write_recent_keyframes, write_scans
from .sensor_models import SensorModelsRecord

HEADER = "session.json"
SCANS = "scans.parquet"
RECENT_KEYFRAMES = "recent_keyframes.parquet"
QUEUED_SCANS = "queued_scans.parquet"
ODOMETRY = "odometry.parquet"
KEYFRAMES = "keyframes.parquet"
WALLS = "walls.parquet"
CORNERS = "corners.parquet"
VARIABLES = "variables.parquet"
FACTORS = "factors.parquet"
LOOP_DECISIONS = "loop_decisions.parquet"
RESTORING_ERRORS = (MapError, ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError)
"""Errors of restoring a state from damaged tables."""


def write_session(directory: Path, session: StoredSession) -> None:
    """Write a session into the directory of a run, which holds the settings already. Raises OSError."""
    folder = directory / SESSION
    folder.mkdir()
    slam_state, mapper = session.slam_state, session.slam_state.mapper
    graph = graph_state(mapper.graph)
    records = ScanSequence.of(session.scans)
    scans = ScanRecords(records, slam_state.trajectory, slam_state.keyframe_stamps, mapper.landmark_ids)
    write_scans(folder / SCANS, scans)
    write_recent_keyframes(folder / RECENT_KEYFRAMES, scans)
    write_queued_scans(folder / QUEUED_SCANS, session.queued_scans)
    write_odometry(folder / ODOMETRY, session.odometry)
    write_keyframes(folder / KEYFRAMES, slam_state.keyframe_stamps, mapper.keyframe_records)
    write_walls(folder / WALLS, mapper.landmarks, mapper.free_space_evidence)
    write_corners(folder / CORNERS, mapper.landmarks)
    write_variables(folder / VARIABLES, graph)
    write_factors(folder / FACTORS, graph.factors, mapper.unconfirmed_observations)
    write_loop_decisions(folder / LOOP_DECISIONS, session.loop_decisions)
    header = SessionHeader.from_parts(
        session.recordings,
        list(session.starts),
        slam_state.checkpoint,
        slam_state.loops.state,
        slam_state.joins.states,
        graph,
        SensorModelsRecord.from_models(
            session.noise, slam_state.odometry_model, mapper.roughness, session.second_noise
        ),
        mapper.landmarks.parts,
    )
    write_header(folder / HEADER, header)


def is_session(path: Path) -> bool:
    """Return True if the directory of a run holds a session. Pose graph results and frozen runs have none."""
    return (path / SESSION / HEADER).is_file()


def read_session(path: Path | str, *, solve: bool = True) -> StoredSession:
    """Read the session in the directory of a run. Raises MapError naming the file and the problem.

    solve  solve the graph with all keyframes. If not, the last ones may be waiting for that, and a continued run gives
           exactly the estimate of an uninterrupted one
    """
    path = Path(path)
    require_results(path)
    folder = path / SESSION
    if not is_session(path):
        raise MapError(
            f"{path}: has no {SESSION}/{HEADER}, so it cannot be continued, refined or corrected: it is damaged, or "
            "the run only localised the robot in another map"
        )
    header = read_header(folder / HEADER)
    config = load_config(path / CONFIG)
    scans = read_scans(folder / SCANS, folder / RECENT_KEYFRAMES)
    landmarks = read_landmarks(folder / WALLS, folder / CORNERS)
    records, odometry = read_keyframes(folder / KEYFRAMES, scans), read_odometry(folder / ODOMETRY)
    check_header(folder / HEADER, header, scans, records, odometry)
    check_landmark_ids(folder / SCANS, scans.landmark_ids, landmarks)
    landmarks.parts = header.map_parts
    slam_state = _read_slam_state(path, config, header, scans, records, landmarks)
    if solve:
        slam_state.mapper.solve_waiting()
    return StoredSession(
        config=config,
        slam_state=slam_state,
        scans=scans.scans,
        odometry=odometry,
        starts=list(header.segment_starts),
        noise=header.sensor_models.noise,
        recordings=list(header.recordings),
        loop_decisions=read_loop_decisions(folder / LOOP_DECISIONS),
        queued_scans=read_queued_scans(folder / QUEUED_SCANS),
        second_noise=header.sensor_models.second_noise,
    )


def _read_slam_state(
    path: Path,
    config: Config,
    header: SessionHeader,
    scans: ScanRecords,
    records: KeyframeRecords,
    landmarks: Landmarks,
) -> SlamState:
    """Read the remaining tables and restore the state. Raises MapError."""
    folder = path / SESSION
    rows = build_scan_history(scans.scans, scans.trajectory, scans.keyframe_stamps, ()).keyframes
    keyframes = {k: scans.scans[row] for k, row in enumerate(rows.tolist())}
    factors, unconfirmed = read_factors(folder / FACTORS)
    graph = read_graph(folder / VARIABLES, factors, **header.graph.model_dump())
    check_landmarks(folder / WALLS, landmarks, len(scans.keyframe_stamps))
    check_variables(folder / VARIABLES, graph, landmarks, len(scans.keyframe_stamps))
    check_factors(folder / FACTORS, graph, factors, unconfirmed, landmarks)
    check_drift(folder / KEYFRAMES, records.correlated_drift, factors)
    free_space_evidence = read_free_space_evidence(folder / WALLS)
    try:
        with np.errstate(divide="raise", over="raise", invalid="raise"):  # damaged numbers raise ArithmeticError
            views = [(keyframes[k].features.segments, keyframes[k].features.points.xy) for k in range(len(rows))]
            mapper = Mapper.from_saved(
                graph, landmarks, header.sensor_models.roughness, free_space_evidence, records, views, unconfirmed
            )
            return SlamState.restored(
                config,
                np.array(header.sensor_models.odometry_samples).reshape(-1, 8),
                mapper,
                scans.trajectory,
                scans.keyframe_stamps,
                header.tracking_checkpoint,
                agreement_state(header.agreement),
                keyframes,
                {group: agreement_state(record) for group, record in header.joins.items()},
                np.array(header.sensor_models.odometry_expected),
            )
    except RESTORING_ERRORS as error:
        raise MapError(f"{path}: the session cannot be restored: {first_line(error)}") from error
