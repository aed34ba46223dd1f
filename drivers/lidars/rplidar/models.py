"""What differs from one RPLIDAR to the next. Speeds of ports are not told apart by the model: they are tried."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

BAUDS = (115200, 256000, 460800, 1000000)
"""Bits a second, in the order to try them."""
DEFAULT_SPEED = 600
"""Revolutions a minute, where the device does not tell what it wants."""
DEFAULT_PWM = 660


class Motor(Enum):
    """How the motor is stopped and started."""

    DTR = "the DTR line: asserted stops the motor, which is what a port does when it is opened"
    PWM = "SET_MOTOR_PWM, if the board it hangs on has a motor driver (GET_MOTOR_BOARD); DTR must not be asserted"
    SPEED = "SET_MOTOR_SPEED, after STOP; a scan starts it"
    SCAN = "starts and stops with the scan"


@dataclass(frozen=True, slots=True)
class Model:
    """A model, or a family where the model is not known.

    bauds      bits a second of its ports, the usual one first
    motor      how it is controlled
    corrected  whether it triangulates: angles are corrected by the distance and may step back
    range_min, range_max  metres, as the data sheets state
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
"""By the major number."""


def model_of(number: int) -> Model:
    """The family of a model number as in `answers.Info`, whose high four bits are the major number."""
    return FAMILIES.get(number >> 4, UNKNOWN)


def name_of(number: int) -> str:
    """A model's name as Slamtec writes it, such as A1M8 or S2M1."""
    family = FAMILIES.get(number >> 4)
    return f"{family.name}M{number & 0x0F}" if family else f"RPLIDAR 0x{number:02X}"
