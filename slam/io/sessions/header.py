"""Write and read `session.json`: format and version, recordings, and the state of tracking and loop search."""

from __future__ import annotations

import reprlib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, SerializerFunctionWrapHandler, field_serializer, model_serializer

from drivers.messages import Odometry

from ...config import Config
from ...errors import MapError
from ...estimation.tracking_checkpoint import Anchor, TrackingCheckpoint
from ...graph.factors import GraphState
from ...localisation.slip_statistics import SlipStatistics
from ...localisation.small_objects import SmallObjects
from ...localisation.tracking import PoseFix, TrackerState
from ...loop_closure.loop_hypothesis import LoopAgreementState
from ...mapping.map_parts import MapParts
from ..json_files import read_json, write_json
from .agreement import AgreementRecord, agreement_record
from .local_field import LocalFieldRecord, local_field_record, local_field_state
from .records import Covariance, Finite, Pose, Record, dumped, to_matrix, to_pose, validated
from .sensor_models import SensorModelsRecord

FORMAT = "wclm-slam session"
SESSION_VERSION = 9
MAX_SPEED = 1e4
"""Largest velocity of a robot, metres or radians per second: far more than any has."""
MAX_BIAS = 1e3
"""Largest range bias, metres: far more than any lidar has."""


class Recording(Record):
    """Recording that is part of a session.

    path         argument of `drivers.open` that opens it again; None if it cannot be opened again
    shift        seconds added to its stamps so that they follow those of the recording before it
    first, last  first and last stamp after the shift, seconds
    recorded_stamps  stamp as read -> stamp as recorded, without the shift, seconds, for those that were restored
    settings     as used: those of the lidars, with what was found of them, and the topic of odometry; a mount is None
                 if the scans state it. None for sessions of older versions
    lidars       mount of each lidar whose scans were used, also as the scans state it; None for older versions
    mounts       only of sessions of older versions: of the lidars, by number, None for one that the scans state
    """

    name: str
    path: str | None
    shift: Finite = 0.0
    first: Finite
    last: Finite
    recorded_stamps: dict[Finite, Finite] = Field(default_factory=dict)
    settings: Config | None = None
    lidars: list[Pose] | None = None
    mounts: list[Pose | None] | None = None

    @field_serializer("settings")
    def _of_recording(self, settings: Config | None) -> dict[str, Any] | None:
        return None if settings is None else settings.of_recording()

    @model_serializer(mode="wrap")
    def _without_empty(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Return the fields; those that not all recordings have only if there is something in them."""
        fields: dict[str, Any] = serialize(self)
        empty = {"recorded_stamps"} if not self.recorded_stamps else set()
        empty |= {name for name in ("settings", "lidars", "mounts") if getattr(self, name) is None}
        return {name: value for name, value in fields.items() if name not in empty}


class _PoseFix(Record):
    pose: Pose
    odometry: Pose
    odometry_stamp: Finite | None = None  # not written by earlier versions
    covariance: Covariance = to_matrix(np.zeros((3, 3)))


class AnchorRecord(Record):
    """See `Anchor`."""

    keyframe: int = Field(ge=0)
    relative: Pose
    covariance: Covariance
    odometry: Pose
    odometry_stamp: Finite | None = None  # not written by earlier versions


_Speed = Annotated[float, Field(allow_inf_nan=False, ge=-MAX_SPEED, le=MAX_SPEED)]
_Variance = Annotated[Finite, Field(ge=0.0)]
_PositiveVariance = Annotated[Finite, Field(gt=0.0)]


class _Tracker(Record):
    fix: _PoseFix
    reference: _PoseFix
    since_fix: Finite | None
    scan_stamp: Finite | None
    intervals: list[Finite]  # earlier versions have written negative ones
    velocity: tuple[_Speed, _Speed, _Speed]
    velocity_variances: tuple[_Variance, _Variance, _Variance]
    prediction_variances: tuple[_PositiveVariance, _PositiveVariance, _PositiveVariance]
    prediction_scans: int = Field(ge=0)
    scans: int = Field(ge=0)
    slips: int = Field(ge=0)
    after_slips: int = Field(default=0, ge=0)
    repeated_slips: int = Field(default=0, ge=0)
    failing: bool = False
    objects: Finite = Field(default=0.0, ge=0.0)
    moved_objects: Finite = Field(default=0.0, ge=0.0)
    contradicted_for: Finite = Field(default=0.0, ge=0.0)
    last_score: Finite


class _Checkpoint(Record):
    tracker: _Tracker | None
    field: LocalFieldRecord
    anchor: AnchorRecord | None
    kidnapped: bool
    kidnapped_keyframes: list[int]
    learned_until: AnchorRecord | None = None

    @model_serializer(mode="wrap")
    def _without_empty(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Return the fields; `learned_until` only between keyframes that are farther apart than the motions learned."""
        fields: dict[str, Any] = serialize(self)
        return fields if self.learned_until else {n: v for n, v in fields.items() if n != "learned_until"}


class _Graph(Record):
    updates: int = Field(ge=0)
    qr: bool
    range_bias: float = Field(gt=-MAX_BIAS, lt=MAX_BIAS)
    waiting: int = Field(default=0, ge=0)


class _Part(Record):
    first: int = Field(ge=0)
    group: int = Field(ge=0)
    measured: bool


class SessionHeader(Record):
    """Contents of `session.json`.

    segment_starts  rows of the scans at which an odometry segment starts
    checkpoint      state of tracking, see `TrackingCheckpoint`
    agreement       state of the search for agreement, see `LoopAgreementState`
    graph           see `GraphState`
    sensor_models   what was learned online
    parts           see `MapParts`; empty if the map has one part
    joins           as `agreement`, of the searches for the place of the last part in other groups of parts, by group
    """

    format: str = FORMAT
    version: int = SESSION_VERSION
    recordings: list[Recording]
    segment_starts: list[int]
    checkpoint: _Checkpoint
    agreement: AgreementRecord
    graph: _Graph
    sensor_models: SensorModelsRecord
    parts: list[_Part] = Field(default_factory=list)
    joins: dict[int, AgreementRecord] = Field(default_factory=dict)

    @model_serializer(mode="wrap")
    def _without_single_part(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Return the fields; those of parts, which few maps have, only if there are several."""
        fields: dict[str, Any] = serialize(self)
        return fields if self.parts else {n: value for n, value in fields.items() if n not in ("parts", "joins")}

    @classmethod
    def from_parts(
        cls,
        recordings: list[Recording],
        segment_starts: list[int],
        checkpoint: TrackingCheckpoint,
        loops: LoopAgreementState,
        joins: Mapping[int, LoopAgreementState],
        graph: GraphState,
        sensor_models: SensorModelsRecord,
        parts: MapParts,
    ) -> SessionHeader:
        """Make the header of a session.

        `loops` and `joins` are the state of the search for loops, and of those for joins, by the group of parts that is
        searched.
        """
        return cls.model_construct(
            recordings=recordings,
            segment_starts=segment_starts,
            checkpoint=_checkpoint_record(checkpoint),
            agreement=agreement_record(loops),
            graph=_Graph.model_construct(
                updates=graph.updates, qr=graph.qr, range_bias=graph.bias, waiting=graph.waiting
            ),
            sensor_models=sensor_models,
            parts=_part_records(parts),
            joins={group: agreement_record(state) for group, state in joins.items()} if parts.apart else {},
        )

    @property
    def map_parts(self) -> MapParts:
        """Parts of the map."""
        if not self.parts:
            return MapParts()
        first, group, measured = zip(*((part.first, part.group, part.measured) for part in self.parts), strict=True)
        return MapParts(first, group, measured)

    @property
    def tracking_checkpoint(self) -> TrackingCheckpoint:
        """State of tracking."""
        tracker = self.checkpoint.tracker
        return TrackingCheckpoint(
            None if tracker is None else _tracker_state(tracker),
            local_field_state(self.checkpoint.field),
            _anchor(self.checkpoint.anchor, tracker),
            self.checkpoint.kidnapped,
            self.checkpoint.kidnapped_keyframes,
            _anchor(self.checkpoint.learned_until, tracker),
        )


def _fix_record(fix: PoseFix) -> _PoseFix:
    return _PoseFix.model_construct(
        pose=to_pose(fix.pose),
        odometry=to_pose(fix.odometry.pose),
        odometry_stamp=fix.odometry.stamp,
        covariance=to_matrix(fix.covariance),
    )


def _tracker_record(state: TrackerState) -> _Tracker:
    return _Tracker.model_construct(
        fix=_fix_record(state.fix),
        reference=_fix_record(state.reference),
        since_fix=state.since_fix,
        scan_stamp=state.scan_stamp,
        intervals=list(state.intervals),
        velocity=to_pose(state.velocity),
        velocity_variances=to_pose(state.velocity_variances),
        prediction_variances=to_pose(state.prediction_variances),
        prediction_scans=state.prediction_scans,
        scans=state.slips.scans,
        slips=state.slips.slips,
        after_slips=state.slips.after_slips,
        repeated_slips=state.slips.repeated_slips,
        failing=state.slips.after_slip,
        objects=state.small_objects.seen,
        moved_objects=state.small_objects.moved,
        contradicted_for=state.contradicted_for,
        last_score=state.last_score,
    )


def _tracker_state(record: _Tracker) -> TrackerState:
    fix, reference = (
        PoseFix(np.array(saved.pose), _reading(saved, record), np.array(saved.covariance))
        for saved in (record.fix, record.reference)
    )
    return TrackerState(
        fix, reference, record.since_fix, record.scan_stamp, tuple(record.intervals), np.array(record.velocity),
        np.array(record.velocity_variances), np.array(record.prediction_variances), record.prediction_scans,
        SlipStatistics(record.scans, record.slips, record.after_slips, record.repeated_slips, record.failing),
        SmallObjects(record.objects, record.moved_objects),
        record.contradicted_for,
        record.last_score,
    )  # fmt: skip


def _checkpoint_record(checkpoint: TrackingCheckpoint) -> _Checkpoint:
    tracker = checkpoint.tracker
    return _Checkpoint.model_construct(
        tracker=None if tracker is None else _tracker_record(tracker),
        field=local_field_record(checkpoint.field),
        anchor=_anchor_record(checkpoint.anchor),
        kidnapped=checkpoint.kidnapped,
        kidnapped_keyframes=list(checkpoint.kidnapped_keyframes),
        learned_until=_anchor_record(checkpoint.learned_until),
    )


def _anchor_record(anchor: Anchor | None) -> AnchorRecord | None:
    if anchor is None:
        return None
    return AnchorRecord.model_construct(
        keyframe=anchor.keyframe,
        relative=to_pose(anchor.relative),
        covariance=to_matrix(anchor.covariance),
        odometry=to_pose(anchor.odometry.pose),
        odometry_stamp=anchor.odometry.stamp,
    )


def _anchor(record: AnchorRecord | None, tracker: _Tracker | None) -> Anchor | None:
    if record is None:
        return None
    reading = _reading(record, tracker)
    return Anchor(record.keyframe, np.array(record.relative), np.array(record.covariance), reading)


def _reading(record: _PoseFix | AnchorRecord, tracker: _Tracker | None) -> Odometry:
    """Return the reading of odometry of a record; without a stamp it is taken to be that of the last scan."""
    last = 0.0 if tracker is None else tracker.scan_stamp or 0.0
    return Odometry(last if record.odometry_stamp is None else record.odometry_stamp, np.array(record.odometry))


def _part_records(parts: MapParts) -> list[_Part]:
    """Return a record of each part; none if there is only one."""
    if len(parts) == 1:
        return []
    return [
        _Part.model_construct(first=first, group=group, measured=measured)
        for first, group, measured in zip(parts.firsts, parts.groups, parts.measured, strict=True)
    ]


def write_header(file: Path, header: SessionHeader) -> None:
    """Write `session.json`. Raises OSError."""
    write_json(file, dumped(header), indent=1)


def read_header(file: Path) -> SessionHeader:
    """Read `session.json`. Raises MapError naming the file and the problem, for example another version."""
    data = read_json(file)
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise MapError(f'{file}: is not a session: its format is not "{FORMAT}"')
    if data.get("version") != SESSION_VERSION:
        version = reprlib.repr(data.get("version"))
        raise MapError(f"{file}: has format version {version}; this program reads version {SESSION_VERSION} only")
    return validated(SessionHeader, data, file)
