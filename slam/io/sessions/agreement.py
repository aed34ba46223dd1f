"""Records of the search for agreement in `session.json`; see `LoopAgreementState`."""

from __future__ import annotations

import numpy as np
from pydantic import AliasChoices, AliasPath, Field, model_validator

from ...loop_closure.decision import LoopMatch
from ...loop_closure.loop_hypothesis import LoopAgreementState, LoopHypothesis, OldPlace
from .records import Finite, InvertibleCovariance, Pose, Record, to_matrix, to_pose


class _Match(Record):
    keyframe: int
    old: int
    relative: Pose
    covariance: InvertibleCovariance
    travelled: Finite
    fit: Finite
    known: Finite


class _Hypothesis(Record):
    motion: Pose
    support: list[_Match] = Field(min_length=1)
    contradictions: list[Finite]
    admitted: bool = True  # earlier versions have not written it


class _Place(Record):
    centre: int
    keyframes: list[int]
    poses: list[Pose]

    @model_validator(mode="after")
    def _check(self) -> _Place:
        if len(self.poses) != len(self.keyframes):
            raise ValueError(f"has {len(self.poses)} poses of {len(self.keyframes)} keyframes")
        return self


class AgreementRecord(Record):
    """State of the search for agreement."""

    last_search: Finite
    places: list[_Place]
    searched: list[tuple[int, Finite]]
    returns: list[Finite]
    # In earlier versions the estimate was a hypothesis.
    contradictions: list[Finite] = Field(
        validation_alias=AliasChoices("contradictions", AliasPath("estimate", "contradictions"))
    )
    hypotheses: list[_Hypothesis]
    candidates: int = Field(ge=0)
    retracted: list[Pose]


def agreement_record(state: LoopAgreementState) -> AgreementRecord:
    """Return the record of a state."""
    return AgreementRecord.model_construct(
        last_search=state.last_search,
        places=[
            _Place.model_construct(
                centre=centre, keyframes=place.keyframes.tolist(), poses=[to_pose(pose) for pose in place.poses]
            )
            for centre, place in state.places
        ],
        searched=list(state.searched),
        returns=list(state.returned_at),
        contradictions=list(state.contradictions),
        hypotheses=[_hypothesis_record(hypothesis) for hypothesis in state.hypotheses],
        candidates=state.candidates,
        retracted=[to_pose(motion) for motion in state.retracted],
    )


def agreement_state(record: AgreementRecord) -> LoopAgreementState:
    """Return the state of a record."""
    places = [
        (place.centre, OldPlace(np.array(place.keyframes, dtype=np.int64), np.array(place.poses).reshape(-1, 3)))
        for place in record.places
    ]
    hypotheses = tuple(_hypothesis(hypothesis) for hypothesis in record.hypotheses)
    return LoopAgreementState(
        record.last_search,
        places,
        record.searched,
        record.returns,
        record.contradictions,
        hypotheses,
        record.candidates,
        [np.array(motion) for motion in record.retracted],
    )


def _hypothesis_record(hypothesis: LoopHypothesis) -> _Hypothesis:
    """Return the record of a hypothesis."""
    support = [
        _Match.model_construct(
            keyframe=match.keyframe,
            old=match.old,
            relative=to_pose(match.relative),
            covariance=to_matrix(match.covariance),
            travelled=match.travelled,
            fit=match.fit,
            known=match.known,
        )
        for match in hypothesis.support
    ]
    return _Hypothesis.model_construct(
        motion=to_pose(hypothesis.motion),
        support=support,
        contradictions=list(hypothesis.contradictions),
        admitted=hypothesis.admitted,
    )


def _hypothesis(record: _Hypothesis) -> LoopHypothesis:
    support = [
        LoopMatch(
            match.keyframe,
            match.old,
            np.array(match.relative),
            np.array(match.covariance),
            match.travelled,
            match.fit,
            match.known,
        )
        for match in record.support
    ]
    contradictions = list(record.contradictions)
    return LoopHypothesis(np.array(record.motion), support, contradictions, admitted=record.admitted)
