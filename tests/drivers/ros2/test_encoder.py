"""Bytes of all messages that the node sends are those of Cyclone DDS's own encoder, and of one written here."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype

from drivers.messages import Odometry, Scan
from drivers.recordings.ros_messages import DIAGNOSTICS, LASER_SCAN, ODOMETRY, TRANSFORMS, decode, type_store
from drivers.ros2.encoder import (
    GRID,
    GRID_INFO,
    MARKERS,
    POSE_WITH_COVARIANCE,
    Drawing,
    Grid,
    Level,
    NodeEncoder,
    Shape,
)

POSE = np.array([1.5, -2.25, 2.0])
STAMP = 1_700_000_000.125
SCAN = Scan(STAMP, np.linspace(1.0, 3.0, 7), np.linspace(-1.0, 1.0, 7), np.linspace(0.0, 0.1, 7), 0.1, 12.0)
OCCUPANCY = Grid(np.array([[0, -1, 100], [100, 0, -1]], dtype=np.int8), np.array([-1.5, 0.25]), 0.05)
DRAWING = Drawing("walls", Shape.LINE_LIST, np.array([[0.0, 1.0], [2.0, 3.0]]), 0.05, (0.1, 0.2, 0.3, 1.0))
MADE: dict[str, Callable[[NodeEncoder], bytes]] = {
    LASER_SCAN: lambda encoder: encoder.scan(SCAN, "laser"),
    ODOMETRY: lambda encoder: encoder.odometry(Odometry(STAMP, POSE)),
    TRANSFORMS: lambda encoder: encoder.transform(STAMP, "map", "odom", POSE),
    POSE_WITH_COVARIANCE: lambda encoder: encoder.pose(STAMP, "map", POSE, np.diag([0.1, 0.2, 0.3])),
    GRID: lambda encoder: encoder.grid(STAMP, "map", OCCUPANCY),
    GRID_INFO: lambda encoder: encoder.grid_info(STAMP, OCCUPANCY),
    MARKERS: lambda encoder: encoder.markers(STAMP, "map", [DRAWING]),
    DIAGNOSTICS: lambda encoder: encoder.status(STAMP, "node", Level.ERROR, "LOST", {"walls": "7"}),
}
FORMATS = {
    "bool": "?", "int8": "b", "uint8": "B", "byte": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I",
    "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip


def plain_cdr(message: Any, msgtype: str) -> bytes:
    """Serialise a message in little-endian CDR by the rules of the standard: each number at a multiple of its size."""
    data = bytearray()

    def number(kind: str, value: Any) -> None:
        data.extend(bytes(-len(data) % struct.calcsize(FORMATS[kind])))
        data.extend(struct.pack(f"<{FORMATS[kind]}", value))

    def write(description: Any, value: Any) -> None:
        kind, content = description
        if kind == Nodetype.NAME:
            for name, inner in type_store("cdr").fielddefs[content][1]:
                write(inner, getattr(value, name))
        elif kind == Nodetype.BASE and content[0] == "string":
            number("uint32", len(value.encode()) + 1)
            data.extend(value.encode() + b"\0")
        elif kind == Nodetype.BASE:
            number(content[0], value)
        else:
            if kind == Nodetype.SEQUENCE:
                number("uint32", len(value))
            for element in value:
                write(content[0], element)

    write((Nodetype.NAME, msgtype), message)
    return b"\0\1\0\0" + bytes(data)


@pytest.mark.parametrize("msgtype", MADE)
def test_bytes_are_those_of_a_plain_encoder(msgtype: str) -> None:
    made = MADE[msgtype](NodeEncoder())
    assert made == plain_cdr(decode(made, msgtype, "cdr"), msgtype)


@pytest.mark.parametrize("msgtype", MADE)
def test_bytes_are_those_of_cyclone_dds(msgtype: str) -> None:
    pytest.importorskip("cyclonedds")
    from drivers.ros2.dds_types import structure_of

    def converted(description: Any, value: Any) -> Any:
        kind, content = description
        if kind == Nodetype.NAME:
            fields = type_store("cdr").fielddefs[content][1]
            return structure_of(content)(**{name: converted(inner, getattr(value, name)) for name, inner in fields})
        if kind == Nodetype.BASE:
            return value
        return [converted(content[0], element) for element in value]

    made = MADE[msgtype](NodeEncoder())
    assert made == converted((Nodetype.NAME, msgtype), decode(made, msgtype, "cdr")).serialize()


def test_covariance_is_in_the_axes_of_the_map() -> None:
    """A robot that looks along y, and is uncertain along its own x axis, is uncertain along y of the map."""
    encoder = NodeEncoder()
    data = encoder.pose(STAMP, "map", np.array([0.0, 0.0, math.pi / 2]), np.diag([0.04, 0.01, 0.09]))
    covariance = decode(data, POSE_WITH_COVARIANCE, "cdr").pose.covariance.reshape(6, 6)
    assert np.diag(covariance) == pytest.approx([0.01, 0.04, 0, 0, 0, 0.09])


def test_grid_is_read_back() -> None:
    message = decode(NodeEncoder().grid(STAMP, "map", OCCUPANCY), GRID, "cdr")
    assert (message.info.width, message.info.height, message.header.frame_id) == (3, 2, "map")
    assert (message.info.origin.position.x, message.info.origin.position.y) == (-1.5, 0.25)
    assert message.data.tolist() == [0, -1, 100, 100, 0, -1]
