"""The RPLIDARs that can be emulated: one of each family, and an A1 whose firmware tells no scan modes."""

from __future__ import annotations

from dataclasses import dataclass

from ..lidars.rplidar.answers import Answer, Info, SampleRate
from ..lidars.rplidar.models import Model, model_of
from ..lidars.rplidar.modes import Modes, ScanMode, modes_of_old, tells_modes
from ..lidars.rplidar.standard import LARGEST


@dataclass(frozen=True, slots=True)
class Kind:
    """A device as it comes out of its box.

    baud   bits a second
    rate   revolutions a second
    modes  that it has; it tells them if its firmware does
    """

    info: Info
    baud: int
    rate: float
    modes: Modes

    @property
    def model(self) -> Model:
        """What differs from model to model."""
        return model_of(self.info.model)

    @property
    def tells_modes(self) -> bool:
        """Whether it answers questions for its modes."""
        return tells_modes(self.info)

    @property
    def sample_rate(self) -> SampleRate:
        """What it answers where it is asked as old firmware is: the first mode's period, and the first capsules'."""
        periods = [mode.sample_period for mode in self.modes.modes]
        return SampleRate(periods[0], periods[min(1, len(periods) - 1)])


def _kind(
    number: int, firmware: tuple[int, int], baud: int, rate: float, typical: int, *modes: tuple[str, float, Answer]
) -> Kind:
    """A kind with modes (name, microseconds a sample, answer)."""
    info = Info(number, firmware, 7, f"{number:02X}" * 4 + "57434C4D" * 3)
    farthest = model_of(number).range_max
    told = [
        ScanMode(i, name, period / 1e6, min(farthest, LARGEST) if answer == Answer.STANDARD else farthest, answer)
        for i, (name, period, answer) in enumerate(modes)
    ]
    return Kind(info, baud, rate, Modes(tuple(told), typical))


_OLD = Info(0x18, (1, 20), 5, "18181818" + "57434C4D" * 3)
_A1_MODES = (
    ("Standard", 508.0, Answer.STANDARD),
    ("Express", 254.0, Answer.EXPRESS),
    ("Boost", 127.0, Answer.ULTRA),
    ("Sensitivity", 127.0, Answer.ULTRA),
    ("Stability", 201.0, Answer.ULTRA),
)
"""As a device with firmware 1.29 tells them."""

KINDS = {
    "rplidar-a1": _kind(0x18, (1, 29), 115200, 7.5, 3, *_A1_MODES),
    "rplidar-a1-old": Kind(_OLD, 115200, 5.5, modes_of_old(SampleRate(508e-6, 254e-6), 12.0)),
    "rplidar-a2": _kind(0x28, (1, 29), 115200, 10.0, 3, *_A1_MODES),
    "rplidar-a3": _kind(
        0x31,
        (1, 29),
        256000,
        15.0,
        3,
        ("Standard", 250.0, Answer.STANDARD),
        ("Express", 125.0, Answer.EXPRESS),
        ("Boost", 62.5, Answer.ULTRA),
        ("Sensitivity", 62.5, Answer.ULTRA),
        ("Stability", 100.0, Answer.ULTRA),
    ),
    "rplidar-c1": _kind(
        0x41, (1, 2), 460800, 10.0, 0, ("Standard", 200.0, Answer.STANDARD), ("DenseBoost", 200.0, Answer.DENSE)
    ),
    "rplidar-s1": _kind(
        0x61,
        (1, 29),
        256000,
        10.0,
        1,
        ("Standard", 250.0, Answer.STANDARD),
        ("DenseBoost", 1e6 / 9200, Answer.DENSE),
        ("HQ", 500.0, Answer.HQ),
    ),
    "rplidar-s2": _kind(
        0x71, (1, 2), 1000000, 10.0, 1, ("Standard", 100.0, Answer.STANDARD), ("DenseBoost", 31.25, Answer.DENSE)
    ),
    "rplidar-s3": _kind(
        0x81, (1, 2), 1000000, 10.0, 1, ("Standard", 100.0, Answer.STANDARD), ("DenseBoost", 31.25, Answer.ULTRA_DENSE)
    ),
}
"""By the name that a user gives. Modes of S and C series are what their data sheets and rates on the wire allow, as no
list of theirs has been published.
"""
