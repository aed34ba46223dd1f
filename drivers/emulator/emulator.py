"""The emulated robot behind its ports, stepped by a clock."""

from __future__ import annotations

import json
import math
import time as clocks
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from types import TracebackType
from typing import Any

import numpy as np

from ..bases.interface import Velocity
from ..errors import RecordingError
from ..realtime import realtime_priority
from ..simulation import LidarModel, World, load_world, warm_up
from ..timestamps import wall_clock_offset
from . import rplidar_variants, wheel_base
from .beam_model import BeamModel
from .connection import DeviceConnection
from .device import EmulatedDevice
from .emulator_setup import EmulatorSetup
from .ground_truth import GroundTruthWriter
from .keyboard import Keyboard, apply_keys
from .ld06 import LD06_VARIANTS, EmulatedLd06
from .pty_port import PtyPort
from .robot_motion import CommandedPilot, PathPilot, RobotMotion
from .rplidar import EmulatedRplidar
from .scip import SCIP_VARIANTS, EmulatedScip
from .serial_line import Corruptor, SerialLine
from .wheel_sensors import Encoders, Gyro

MAX_STEP = 0.5
"""Seconds; longer steps, as after the host was suspended, are divided."""
MIN_PAUSE, MAX_PAUSE = 0.001, 0.005
"""Seconds to sleep between steps. Within these limits it wakes when a packet is complete, so that packets arrive in
time; requests of the host wait for the next step.
"""


class Emulator:
    """A simulated robot; a context manager that creates the ports on entering and removes them on leaving.

    setup   settings
    begun   the host's steady clock (seconds) at time zero
    day     wall-clock time at time zero (seconds since 1970), used to stamp the ground truth
    motion  the robot's true motion

    Raises RecordingError if the world does not exist or a file cannot be written, PortError if a port cannot be
    created, DriverError if there is no keyboard.
    """

    def __init__(self, setup: EmulatorSetup, begun: float | None = None) -> None:
        self.setup = setup
        warm_up()  # compiles for seconds the first time, which must not happen while time passes
        self.begun = clocks.monotonic() if begun is None else begun
        self.day = self.begun + wall_clock_offset()
        self._world = setup.world if isinstance(setup.world, World) else load_world(setup.world)
        self._pilot = CommandedPilot(self._world)
        self.motion = RobotMotion(self._world, PathPilot(self._world) if setup.drive == "path" else self._pilot)
        self._time = self._longest_pause = 0.0
        self._open_resources = ExitStack()

    def __enter__(self) -> Emulator:
        setup = self.setup
        beams, wheels, gyro, *noises = np.random.default_rng(setup.seed).spawn(7)
        with ExitStack() as opening:
            self._keyboard = opening.enter_context(Keyboard()) if setup.drive == "keyboard" else None
            self._truth = (
                opening.enter_context(GroundTruthWriter(setup.truth, self.motion, self.day)) if setup.truth else None
            )
            self.lidar = self._connect(opening, "lidar", self._lidar(beams), noises[:2])
            self.base = self._connect(opening, "base", self._base(wheels, gyro), noises[2:])
            if setup.report is not None:
                opening.callback(self._write_report)
            self._open_resources = opening.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open_resources.close()

    def _connect(
        self, opening: ExitStack, who: str, device: EmulatedDevice, random: list[np.random.Generator]
    ) -> DeviceConnection:
        """Connect a device to its port."""
        setup = self.setup
        port = PtyPort(setup.lidar_port if who == "lidar" else setup.base_port)
        opening.callback(port.unplug)
        events = [event for event in setup.events if event.device == who]
        return DeviceConnection(
            device, port, events, Corruptor(setup.drop, setup.insert, setup.flip, random[0]), random[1]
        )

    def _lidar(self, random: np.random.Generator) -> EmulatedDevice:
        setup, drift = self.setup, self.setup.lidar_drift / 1e6

        def beams(range_min: float, range_max: float) -> BeamModel:
            noise: LidarModel = replace(setup.noise, range_min=range_min, range_max=range_max)
            return BeamModel(self.motion, np.array(setup.mount, dtype=np.float64), noise, random)

        if setup.lidar in LD06_VARIANTS:
            model = LD06_VARIANTS[setup.lidar]
            limits = beams(model.range_min, model.range_max)
            return EmulatedLd06(setup.lidar, SerialLine(model.baud), drift, limits, model)
        if setup.lidar in SCIP_VARIANTS:
            parameters = SCIP_VARIANTS[setup.lidar]
            limits = beams(parameters.range_min, parameters.range_max)
            return EmulatedScip(setup.lidar, SerialLine(math.inf), drift, limits, parameters)
        kind = rplidar_variants.RPLIDAR_VARIANTS[setup.lidar]
        limits = beams(kind.model.range_min, kind.model.range_max)
        return EmulatedRplidar(setup.lidar, SerialLine(kind.baud), drift, kind, limits)

    def _base(self, random: np.random.Generator, gyro: np.random.Generator) -> EmulatedDevice:
        setup, kind = self.setup, wheel_base.BASE_VARIANTS[self.setup.base]
        encoders = Encoders(self.motion, kind.wheels, setup.wheels, random)
        obey: Callable[[Velocity], None] = self._set_target_velocity if setup.drive == "base" else lambda _: None
        line, drift = SerialLine(kind.baud), setup.base_drift / 1e6
        return wheel_base.EmulatedWheelBase(setup.base, line, drift, kind, encoders, Gyro(self.motion, gyro), obey)

    def _set_target_velocity(self, velocity: Velocity) -> None:
        self._pilot.target = velocity

    @property
    def due(self) -> float:
        """Latest time of the next step."""
        return min(self.lidar.due, self.base.due)

    def step(self, time: float) -> None:
        """Process everything up to a time, seconds since the start; times must not decrease."""
        while self._time < time:
            self._time = min(time, self._time + MAX_STEP)
            if self._keyboard is not None:
                self._pilot.target = apply_keys(self._pilot.target, self._keyboard.read_keys())
            self.motion.advance(self._time)
            self.lidar.step(self._time)
            self.base.step(self._time)
            if self._truth is not None:
                self._truth.advance(self._time)

    def run(self, duration: float | None = None) -> None:
        """Run in real time, for a duration in seconds or until interrupted."""
        end = math.inf if duration is None else clocks.monotonic() - self.begun + duration
        # Hardware does not wait for a processor. Without priority, an emulator on a busy computer sends later than any
        # real device would, and programs interpret that as lost measurements.
        with realtime_priority():
            before = clocks.monotonic() - self.begun
            while (now := clocks.monotonic() - self.begun) < end:
                self._longest_pause, before = max(self._longest_pause, now - before), now
                self.step(now)
                pause = self.due - (clocks.monotonic() - self.begun)
                clocks.sleep(min(max(pause, MIN_PAUSE), MAX_PAUSE))

    def report(self) -> dict[str, Any]:
        """Return what happened so far, as plain values; `seconds` counts from `begun`, seconds since 1970.

        `longest_pause` is the longest time between two steps in real time, seconds: more than 5 ms and the computing
        time of a step only if the computer was held up, and then the devices were silent.
        """
        setup = self.setup
        return {
            "world": self._world.name,
            "seed": setup.seed,
            "begun": self.day,
            "seconds": self._time,
            "longest_pause": self._longest_pause,
            "mount": list(setup.mount),
            "lidar": self.lidar.report(),
            "base": self.base.report(),
        }

    def _write_report(self) -> None:
        path = self.setup.report
        assert path is not None
        try:
            path.write_text(json.dumps(self.report(), indent=2) + "\n", encoding="utf-8")
        except OSError as failure:
            raise RecordingError(path, None, f"cannot be written: {failure.strerror}") from failure
