"""Models of the sensors that a drive has learned, as part of `session.json`."""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np
from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from features import LearnedNoise

from ...config import LidarConfig
from ...geometry.roughness import Roughness
from ...mapping.wall_roughness import INITIAL_VARIANCE, WallRoughness
from ...odometry.error_model import OdometryModel
from ...odometry.systematic_errors import PERFECT
from .records import Finite, Record

MAX_SYSTEMATIC_ERROR = 10.0
"""Largest systematic error of odometry: far more than any has."""
EXPECTED_VARIANCES = 1e-12, 1e12
"""Square metres, limits of what is expected of a sample of roughness: from a micrometre to what nothing determines."""
_Sample = tuple[Finite, Annotated[Finite, Field(ge=EXPECTED_VARIANCES[0], le=EXPECTED_VARIANCES[1])]]
_Variance = Annotated[Finite, Field(ge=0.0, le=EXPECTED_VARIANCES[1])]
_RoughnessSample = tuple[_Sample, _Sample]
_SystematicError = Annotated[Finite, Field(ge=-MAX_SYSTEMATIC_ERROR, le=MAX_SYSTEMATIC_ERROR)]


class SensorModelsRecord(Record):
    """Noise of rays, and samples of odometry's errors and of the wall roughness.

    sigma_range, sigma_bearing, segmentation_range  see `LearnedNoise`; sessions that were made when the bearing noise
                      was not estimated have the first only
    noise_scans, noise_lines  weights of the first two, likewise; None if not known
    odometry_samples  (n, 8)
    odometry_expected (6,) see `OdometryModel.expected_errors`
    roughness_samples (m, 2, 2) see `WallRoughness.samples`; earlier sessions have (m,) excesses of either kind
    roughness_variances  (2,) see `WallRoughness.variances`; None in earlier sessions
    second_*          of the second lidar; None if there is none
    """

    sigma_range: Finite = Field(gt=0.0)
    sigma_bearing: Finite | None = Field(default=None, gt=0.0, le=math.pi)
    segmentation_range: Finite | None = Field(default=None, gt=0.0)
    noise_scans: Finite | None = Field(default=None, gt=0.0)
    noise_lines: Finite | None = Field(default=None, gt=0.0)
    odometry_samples: list[list[Finite]]
    odometry_expected: list[_SystematicError] = Field(default=PERFECT.tolist(), min_length=6, max_length=6)
    roughness_samples: list[_RoughnessSample | Finite]
    roughness_variances: tuple[_Variance, _Variance] | None = None
    second_sigma_range: Finite | None = Field(default=None, gt=0.0)
    second_sigma_bearing: Finite | None = Field(default=None, gt=0.0, le=math.pi)
    second_segmentation_range: Finite | None = Field(default=None, gt=0.0)
    second_noise_scans: Finite | None = Field(default=None, gt=0.0)
    second_noise_lines: Finite | None = Field(default=None, gt=0.0)

    @classmethod
    def from_models(
        cls, noise: LearnedNoise, odometry: OdometryModel, roughness: WallRoughness, second_noise: LearnedNoise | None
    ) -> SensorModelsRecord:
        """Make the record from the models; `second_noise` is None without a second lidar."""
        return cls.model_construct(
            **_values(noise),
            odometry_samples=odometry.samples.tolist(),
            odometry_expected=odometry.expected_errors.tolist(),
            roughness_samples=roughness.samples.tolist(),
            roughness_variances=(roughness.variances.offset, roughness.variances.ends),
            **({} if second_noise is None else _values(second_noise, "second_")),
        )

    @property
    def roughness(self) -> WallRoughness:
        """Estimate of the wall roughness; the samples of earlier sessions are of both kinds, with equal weights."""
        samples = [[(s, INITIAL_VARIANCE)] * 2 if isinstance(s, float) else s for s in self.roughness_samples]
        variances = None if self.roughness_variances is None else Roughness(*self.roughness_variances)
        return WallRoughness.restored(np.array(samples, dtype=np.float64).reshape(-1, 2, 2), variances)

    @property
    def noise(self) -> LearnedNoise:
        """Noise of a ray of the lidar."""
        return _noise(self.sigma_range, self.sigma_bearing, self.segmentation_range, self.noise_scans, self.noise_lines)

    @property
    def second_noise(self) -> LearnedNoise | None:
        """Noise of a ray of the second lidar; None if there is none."""
        if self.second_sigma_range is None:
            return None
        return _noise(
            self.second_sigma_range,
            self.second_sigma_bearing,
            self.second_segmentation_range,
            self.second_noise_scans,
            self.second_noise_lines,
        )

    @model_serializer(mode="wrap")
    def _without_second_lidar(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Return the fields without those that are None: few robots have a second lidar."""
        fields: dict[str, Any] = serialize(self)
        return {name: value for name, value in fields.items() if value is not None}


def _values(noise: LearnedNoise, prefix: str = "") -> dict[str, Any]:
    """Return the values of the noise of a ray by the names of their fields; weights only if they are known."""
    values = {
        "sigma_range": noise.sigma_range,
        "sigma_bearing": noise.sigma_bearing,
        "segmentation_range": noise.segmentation_range,
        "noise_scans": noise.scans,
        "noise_lines": noise.lines,
    }
    return {prefix + name: value for name, value in values.items() if math.isfinite(value)}


def _noise(
    sigma_range: float,
    sigma_bearing: float | None,
    segmentation_range: float | None,
    scans: float | None,
    lines: float | None,
) -> LearnedNoise:
    """Return the noise of a ray; what an earlier version has not written is that of a data sheet, or the same."""
    return LearnedNoise(
        sigma_range,
        sigma_bearing or LidarConfig().sigma_bearing,
        segmentation_range or sigma_range,
        scans or math.inf,
        lines or math.inf,
    )
