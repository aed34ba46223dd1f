"""Definitions of the services that slam_toolbox offers, and their hashes, by which zenoh finds them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.store import Typestore

from ..recordings.ros_messages import type_store

GET_MAP = "nav_msgs/srv/GetMap"
SAVE_MAP = "slam_toolbox/srv/SaveMap"
SERIALIZE_MAP = "slam_toolbox/srv/SerializePoseGraph"
DESERIALIZE_MAP = "slam_toolbox/srv/DeserializePoseGraph"
PAUSE = "slam_toolbox/srv/Pause"
RESET = "slam_toolbox/srv/Reset"
SET_BOOL = "std_srvs/srv/SetBool"

DEFINITIONS = {
    GET_MAP: ("", "nav_msgs/OccupancyGrid map"),
    SAVE_MAP: ("std_msgs/String name", "uint8 result"),
    SERIALIZE_MAP: ("string filename", "uint8 result"),
    DESERIALIZE_MAP: ("string filename\nint8 match_type\ngeometry_msgs/Pose2D initial_pose", ""),
    PAUSE: ("", "bool status"),
    RESET: ("bool pause_new_measurements false", "uint8 result"),
    SET_BOOL: ("bool data", "bool success\nstring message"),
}
"""Fields of request and response. Constants are left out: neither bytes nor hashes contain them."""

EVENT_INFO = "service_msgs/msg/ServiceEventInfo"
EVENT_INFO_FIELDS = "uint8 event_type\nbuiltin_interfaces/Time stamp\nuint8[16] client_gid\nint64 sequence_number"
"""Part of every service's hash, for the introspection of services."""


@cache
def service_store() -> Typestore:
    """Return the type store of the messages, in which the services are registered as well."""
    store = type_store("cdr")
    store.register(get_types_from_msg(EVENT_INFO_FIELDS, EVENT_INFO))
    for name, (request, response) in DEFINITIONS.items():
        register_service(store, name, request, response)
    return store


def register_service(store: Typestore, name: str, request: str, response: str) -> None:
    """Register the types that ROS derives from a service: NAME_Request, NAME_Response, NAME_Event, and NAME itself."""
    event = f"{EVENT_INFO} info\n{name}_Request[<=1] request\n{name}_Response[<=1] response"
    whole = f"{name}_Request request_message\n{name}_Response response_message\n{name}_Event event_message"
    for suffix, definition in (("_Request", request), ("_Response", response), ("_Event", event), ("", whole)):
        types = get_types_from_msg(definition, f"{name}{suffix}")
        store.register({_service_name(key): ([], _renamed(fields)) for key, (_, fields) in types.items()})


def _service_name(name: str) -> str:
    """Return the name of a type of a service without the `msg` that the parser puts into all names."""
    return name.replace("/srv/msg/", "/srv/")


def _renamed(part: Any) -> Any:
    """Return a part of parsed definitions with all names of services changed."""
    if isinstance(part, str):
        return _service_name(part)
    return type(part)(_renamed(inner) for inner in part) if isinstance(part, tuple | list) else part


def decode_request(srvtype: str, data: bytes) -> Any:
    """Deserialise a request of a service."""
    return service_store().deserialize_cdr(data, f"{srvtype}_Request")


def encode_response(srvtype: str, members: Mapping[str, Any]) -> bytes:
    """Serialise a response of a service; members that are not given are empty."""
    return _encode(f"{srvtype}_Response", members)


def encode_request(srvtype: str, members: Mapping[str, Any]) -> bytes:
    """Serialise a request of a service; members that are not given are empty."""
    return _encode(f"{srvtype}_Request", members)


def _encode(name: str, members: Mapping[str, Any]) -> bytes:
    message = empty_message(name)
    for member, value in members.items():
        object.__setattr__(message, member, value)
    return bytes(service_store().serialize_cdr(message, name))


def empty_message(name: str) -> Any:
    """Return a message of a registered type in which all numbers are zero and all strings and lists are empty."""
    store = service_store()
    return store.types[name](**{field: _empty(kind) for field, kind in store.fielddefs[name][1]})


def _empty(description: Any) -> Any:
    kind, content = description
    if kind == Nodetype.NAME:
        return empty_message(content)
    if kind == Nodetype.BASE:
        return {"string": "", "bool": False}.get(content[0], 0)
    (element, inner), count = content
    if element == Nodetype.BASE and inner[0] != "string":
        return np.zeros(count if kind == Nodetype.ARRAY else 0, dtype=inner[0])
    return [_empty((element, inner)) for _ in range(count if kind == Nodetype.ARRAY else 0)]


def service_hash(name: str) -> str:
    """Return the hash of a service type as in RIHS01."""
    return service_store().hash_rihs01(name)
