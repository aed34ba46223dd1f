"""Differences between the models of RPLIDARs. Baud rates do not follow from the model: they are tried."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

BAUDS = (115200, 256000, 460800, 1000000)
"""Bits per second, in the order in which they are tried."""
DEFAULT_SPEED = 600
"""Revolutions per minute, if the device does not report the desired speed."""
DEFAULT_PWM = 660
"""PWM duty, 0 to 1023, if the device does not report the desired one."""


class Motor(Enum):
    """Control of the motor."""

    DTR = "the DTR line: asserted stops the motor; opening a port asserts it"
    PWM = "SET_MOTOR_PWM, if the adapter board has a motor driver (GET_MOTOR_BOARD); DTR must not be asserted"
    SPEED = "SET_MOTOR_SPEED, after STOP; a scan starts it"
    SCAN = "starts and stops with the scan"


@dataclass(frozen=True, slots=True)
class Model:
    """A model, or a family if the model is unknown.

    bauds        bits per second of its ports, the usual one first
    motor        control of the motor
    triangulates  True if it measures by triangulation: angles are corrected by the distance and may step back
    range_min, range_max  metres, from the data sheets
    """

    name: str
    bauds: tuple[int, ...]
    motor: Motor
    triangulates: bool
    range_min: float
    range_max: float


A1 = Model("A1", (115200,), Motor.DTR, True, 0.15, 12.0)
A2 = Model("A2", (115200, 256000), Motor.PWM, True, 0.15, 18.0)
A3 = Model("A3", (256000, 115200), Motor.PWM, True, 0.15, 25.0)
C1 = Model("C1", (460800,), Motor.SCAN, False, 0.05, 16.0)
S1 = Model("S1", (256000,), Motor.SPEED, False, 0.1, 40.0)
S2 = Model("S2", (1000000,), Motor.SPEED, False, 0.05, 30.0)
S3 = Model("S3", (1000000, 460800), Motor.SPEED, False, 0.05, 40.0)
UNKNOWN = Model("RPLIDAR", BAUDS, Motor.SPEED, False, 0.05, 40.0)

FAMILIES = {1: A1, 2: A2, 3: A3, 4: C1, 6: S1, 7: S2, 8: S3}
"""Families by the major model number."""


def model_of(number: int) -> Model:
    """Return the family of a model number as in `responses.Info`, whose high four bits are the major number."""
    return FAMILIES.get(number >> 4, UNKNOWN)


def name_of(number: int) -> str:
    """Return a model's name as Slamtec writes it, such as A1M8 or S2M1."""
    family = FAMILIES.get(number >> 4)
    return f"{family.name}M{number & 0x0F}" if family else f"RPLIDAR 0x{number:02X}"
