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


@cache
def dds_type(msgtype: str) -> type[Any]:
    """Return the type of a ROS message whose samples `kind(data)` are bytes of CDR with their header, in `data`."""

    def create(self: Any, data: bytes) -> None:
        self.data = data

    def serialise(self: Any, *_: Any, **__: Any) -> bytes:
        return bytes(self.data)

    def deserialise(cls: type[Any], data: bytes, *_: Any, **__: Any) -> Any:
        return cls(bytes(data))

    kind = _build(msgtype)  # not a subclass: that would be another type for Cyclone DDS
    kind.__init__, kind.serialize, kind.deserialize = create, serialise, classmethod(deserialise)
    return kind


@cache
def structure_of(msgtype: str) -> type[Any]:
    """Return the type of a ROS message with members, which Cyclone DDS itself can serialise."""
    return _build(msgtype)


def _build(msgtype: str) -> type[Any]:
    fields = type_store("cdr").fielddefs[msgtype][1]
    members = {name: _member(description) for name, description in fields}
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
