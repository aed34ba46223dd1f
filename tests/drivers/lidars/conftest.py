"""The same few revolutions in a simulated room, as the bytes of every lidar."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from drivers.lidars import ld06, scip, scip_scan
from drivers.lidars.measurements import Decoder
from drivers.lidars.rplidar import dense, express, hq, standard, ultra, ultra_dense
from drivers.lidars.rplidar.decoding import decoder_for
from drivers.lidars.rplidar.responses import ResponseType
from drivers.messages import Floats

RATE = 9.7  # revolutions per second
URG = scip.Parameters("URG-04LX", 0.02, 5.6, 1024, 44, 725, 384, 600.0)
MEASURE = scip.MeasureRequest(44, 725)


@dataclass(frozen=True)
class Stream:
    """Bytes of a lidar over some revolutions, their duration, and their decoder."""

    data: bytes
    decoder: Callable[[], Decoder]
    revolutions: float
    seconds: float
    samples: int  # in a packet
    whole_packets: bool = False


def room(bearings: Floats, seed: int) -> Floats:
    """Return noisy ranges along directions: walls, objects in front of them, beams without return."""
    random = np.random.default_rng(seed)
    walls = 2.5 / np.maximum(np.abs(np.cos(bearings)), np.abs(np.sin(bearings)))
    things = np.where(np.mod(bearings * 5.0, 2 * np.pi) < 0.6, 0.5, 1.0)
    ranges = np.round(walls * things + random.normal(0.0, 0.01, len(bearings)), 3)
    return np.where(random.random(len(bearings)) < 0.03, np.nan, ranges)


def starts_of(bearings: Floats) -> np.ndarray:
    turns = np.floor(bearings / (2 * np.pi))
    return np.diff(turns, prepend=-1.0) > 0


@cache
def make_stream(kind: str, revolutions: float, seed: int = 1) -> Stream:
    """Return the bytes of about `revolutions` revolutions."""
    if kind == "scip":
        scans = round(revolutions)
        steps = (MEASURE.first + np.arange(MEASURE.count) - URG.front) * 2 * np.pi / URG.steps
        data = b"".join(
            scip_scan.encode(room(steps, seed + k), MEASURE, round(1e5 * k / 971) + 123) for k in range(scans)
        )
        return Stream(
            data, lambda: scip_scan.ScipDecoder(URG, MEASURE), scans, scans / 10.0, MEASURE.count, whole_packets=True
        )
    rate, count, baud = {
        "standard-a1": (2000, 1, 115200),
        "standard-c1": (5000, 1, 460800),
        "express": (4000, 32, 115200),
        "ultra": (16000, 96, 256000),
        "dense": (9200, 40, 256000),
        "ultra-dense": (32000, 64, 1000000),
        "hq": (16000, 96, 1000000),
        "ld06": (4500, 12, 230400),
    }[kind]
    packets = int(revolutions / RATE * rate / count)
    bearings = (2 * np.pi * RATE / rate * np.arange(packets * count) + 1e-9).reshape(packets, count)
    ranges = room(bearings.ravel(), seed).reshape(packets, count)
    heads, flat, ones = bearings[:, 0], ranges.ravel(), np.full(ranges.shape, 47)
    starts = starts_of(bearings.ravel())
    answers = {
        "standard-a1": ResponseType.STANDARD,
        "standard-c1": ResponseType.STANDARD,
        "express": ResponseType.EXPRESS,
        "ultra": ResponseType.ULTRA,
        "dense": ResponseType.DENSE,
        "ultra-dense": ResponseType.ULTRA_DENSE,
        "hq": ResponseType.HQ,
    }
    if kind == "ld06":
        data = b"".join(
            ld06.encode(
                bearings[k : k + 1, [0, -1]], ranges[k : k + 1], ones[k : k + 1], 2 * np.pi * RATE, k * count / rate
            )
            for k in range(packets)
        )
        return Stream(data, ld06.Ld06Decoder, revolutions, packets * count / rate, count)
    triangulates = kind in ("standard-a1", "express", "ultra")
    if kind == "standard-a1":
        lag = np.radians(ultra.correction(np.nan_to_num(flat * 1e3).astype(np.int64)))
        data = standard.encode(bearings.ravel() - lag, flat, ones.ravel(), starts)
    elif kind == "standard-c1":
        data = standard.encode(bearings.ravel(), flat, ones.ravel(), starts)
    elif kind == "express":
        lag = np.radians(ultra.correction(np.nan_to_num(ranges * 1e3).astype(np.int64)))
        data = express.encode(heads, ranges, lag, reset=True)
    elif kind == "ultra":
        data = ultra.encode(heads, ranges, reset=True)
    elif kind == "dense":
        data = dense.encode(heads, ranges, reset=True)
    elif kind == "ultra-dense":
        data = ultra_dense.encode(heads, ranges, ones, reset=True)
    else:
        data = hq.encode(bearings, ranges, ones, starts.reshape(ranges.shape))
    return Stream(
        data,
        lambda: decoder_for(answers[kind], 1.0 / rate, baud, triangulates),
        revolutions,
        packets * count / rate,
        count,
    )


KINDS = ["standard-a1", "standard-c1", "express", "ultra", "dense", "ultra-dense", "hq", "ld06", "scip"]


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    return name


@pytest.fixture
def stream_of() -> Callable[[str, float], Stream]:
    return make_stream
