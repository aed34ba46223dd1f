"""Simulate a robot with a lidar and wheel encoders in a building: `Simulation` is a source of measurements."""

from __future__ import annotations

from .lidar_model import LIDAR_MODELS, LidarModel
from .simulator import Simulation, warm_up
from .wheel_model import WHEEL_MODELS, WheelBiases, WheelModel
from .world import TemporaryShapes, World, WorldFile, build_world, load_world, load_world_file, world_names

__all__ = [
    "LIDAR_MODELS",
    "WHEEL_MODELS",
    "LidarModel",
    "Simulation",
    "TemporaryShapes",
    "WheelBiases",
    "WheelModel",
    "World",
    "WorldFile",
    "build_world",
    "load_world",
    "load_world_file",
    "warm_up",
    "world_names",
]
