"""The RPLIDARs that can be emulated: one of each family, and an A1 with firmware without scan modes."""

from __future__ import annotations

from dataclasses import dataclass

from ..lidars.rplidar.models import Model, model_of
from ..lidars.rplidar.modes import Modes, ScanMode, legacy_modes, reports_modes
from ..lidars.rplidar.responses import Info, ResponseType, SampleRate
from ..lidars.rplidar.standard import MAX_RANGE


@dataclass(frozen=True, slots=True)
class RplidarVariant:
    """A device with its factory settings.

    baud   bits per second
    rate   revolutions per second
    modes  scan modes; reported if the firmware does so
    """

    info: Info
    baud: int
    rate: float
    modes: Modes

    @property
    def model(self) -> Model:
        """Properties of the model."""
        return model_of(self.info.model)

    @property
    def reports_modes(self) -> bool:
        """True if it responds to queries for its modes."""
        return reports_modes(self.info)

    @property
    def sample_rate(self) -> SampleRate:
        """Response to the query of old hosts: the periods of the first mode and of the first capsule mode."""
        periods = [mode.sample_period for mode in self.modes.modes]
        return SampleRate(periods[0], periods[min(1, len(periods) - 1)])


def _variant(
    number: int,
    firmware: tuple[int, int],
    baud: int,
    rate: float,
    typical: int,
    *modes: tuple[str, float, ResponseType],
) -> RplidarVariant:
    """Create a variant with modes (name, microseconds per sample, response type)."""
    info = Info(number, firmware, 7, f"{number:02X}" * 4 + "57434C4D" * 3)
    farthest = model_of(number).range_max
    modes_of_variant = [
        ScanMode(
            i,
            name,
            period / 1e6,
            min(farthest, MAX_RANGE) if response_type == ResponseType.STANDARD else farthest,
            response_type,
        )
        for i, (name, period, response_type) in enumerate(modes)
    ]
    return RplidarVariant(info, baud, rate, Modes(tuple(modes_of_variant), typical))


_OLD_A1_INFO = Info(0x18, (1, 20), 5, "18181818" + "57434C4D" * 3)
_A1_MODES = (
    ("Standard", 508.0, ResponseType.STANDARD),
    ("Express", 254.0, ResponseType.EXPRESS),
    ("Boost", 127.0, ResponseType.ULTRA),
    ("Sensitivity", 127.0, ResponseType.ULTRA),
    ("Stability", 201.0, ResponseType.ULTRA),
)
"""As reported by a device with firmware 1.29."""

RPLIDAR_VARIANTS = {
    "rplidar-a1": _variant(0x18, (1, 29), 115200, 7.5, 3, *_A1_MODES),
    "rplidar-a1-old": RplidarVariant(_OLD_A1_INFO, 115200, 5.5, legacy_modes(SampleRate(508e-6, 254e-6), 12.0)),
    "rplidar-a2": _variant(0x28, (1, 29), 115200, 10.0, 3, *_A1_MODES),
    "rplidar-a3": _variant(
        0x31,
        (1, 29),
        256000,
        15.0,
        3,
        ("Standard", 250.0, ResponseType.STANDARD),
        ("Express", 125.0, ResponseType.EXPRESS),
        ("Boost", 62.5, ResponseType.ULTRA),
        ("Sensitivity", 62.5, ResponseType.ULTRA),
        ("Stability", 100.0, ResponseType.ULTRA),
    ),
    "rplidar-c1": _variant(
        0x41,
        (1, 2),
        460800,
        10.0,
        0,
        ("Standard", 200.0, ResponseType.STANDARD),
        ("DenseBoost", 200.0, ResponseType.DENSE),
    ),
    "rplidar-s1": _variant(
        0x61,
        (1, 29),
        256000,
        10.0,
        1,
        ("Standard", 250.0, ResponseType.STANDARD),
        ("DenseBoost", 1e6 / 9200, ResponseType.DENSE),
        ("HQ", 500.0, ResponseType.HQ),
    ),
    "rplidar-s2": _variant(
        0x71,
        (1, 2),
        1000000,
        10.0,
        1,
        ("Standard", 100.0, ResponseType.STANDARD),
        ("DenseBoost", 31.25, ResponseType.DENSE),
    ),
    "rplidar-s3": _variant(
        0x81,
        (1, 2),
        1000000,
        10.0,
        1,
        ("Standard", 100.0, ResponseType.STANDARD),
        ("DenseBoost", 31.25, ResponseType.ULTRA_DENSE),
    ),
}
"""Variants by the name that a user gives. Modes of the S and C series are what their data sheets and the rates on the
wire allow, as no list of them has been published.
"""
