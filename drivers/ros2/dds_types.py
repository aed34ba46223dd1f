"""Types of Cyclone DDS for ROS messages, whose samples are already serialised.

Cyclone DDS announces the structure of a type to others, which compare it with their own; so the types have the true
members, although their samples are only bytes.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from cyclonedds.idl import make_idl_struct, types
from cyclonedds.idl.annotations import final
from rosbags.interfaces import Nodetype

from ..recordings.ros_messages import type_store
from .link import mangled_type

PRIMITIVES: dict[str, Any] = {
    "bool": bool,
    "byte": types.uint8,
    "char": types.uint8,
    "float32": types.float32,
    "float64": types.float64,
    "string": str,
    **{f"{sign}int{bits}": getattr(types, f"{sign}int{bits}") for sign in ("", "u") for bits in (8, 16, 32, 64)},
}


class Serialised:
    """Sample of a type: `data` are the bytes of the message in CDR, with their header."""

    def __init__(self, data: bytes) -> None:
        self.data = data

    def serialize(self, *_: Any, **__: Any) -> bytes:
        """Return the bytes."""
        return self.data

    @classmethod
    def deserialize(cls, data: bytes, *_: Any, **__: Any) -> Serialised:
        """Return a sample of the bytes."""
        return cls(bytes(data))


@cache
def dds_type(msgtype: str) -> type[Any]:
    """Return the type of a ROS message, for example nav_msgs/msg/Odometry, with samples of the class Serialised."""
    structure = structure_of(msgtype)
    kind: type[Any] = type(structure.__name__, (Serialised, structure), {})
    return kind


@cache
def structure_of(msgtype: str) -> type[Any]:
    """Return the type of a ROS message with members, which Cyclone DDS itself can serialise."""
    fields = type_store("cdr").fielddefs[msgtype][1]
    members = {name: _member(description) for name, description in fields}
    if not members:  # as ROS does it
        members = {"structure_needs_at_least_one_member": types.uint8}
    name = mangled_type(msgtype)
    structure: type[Any] = final(make_idl_struct(name.rpartition("::")[2], name, members))
    return structure


def _member(description: Any) -> Any:
    kind, content = description
    if kind == Nodetype.BASE:
        return PRIMITIVES[content[0]]
    if kind == Nodetype.NAME:
        return structure_of(content)
    element, count = content
    return types.array[_member(element), count] if kind == Nodetype.ARRAY else types.sequence[_member(element)]
