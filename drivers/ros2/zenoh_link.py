"""Link to ROS 2 robots with rmw_zenoh, on the package eclipse-zenoh.

Keys, attachments and liveliness tokens are those of the design document of rmw_zenoh. As there, nodes find each other
through a router, `ros2 run rmw_zenoh_cpp rmw_zenohd`. ZENOH_SESSION_CONFIG_URI and ZENOH_CONFIG_OVERRIDE have the same
meaning as there.
"""

from __future__ import annotations

import itertools
import os
import struct
import threading
import time
import uuid
from pathlib import Path
from typing import Any

import zenoh
import zenoh.ext

from ..errors import DriverError
from ..recordings.ros_messages import type_store
from .link import Answer, Put, QoS, Receive, mangled_type
from .names import NodeNames
from .services import service_hash

SESSION = """{
  mode: "peer",
  connect: { endpoints: ["tcp/localhost:7447"] },
  listen: { endpoints: ["tcp/localhost:0"] },
  scouting: {
    multicast: { enabled: false },
    gossip: { enabled: true, target: { router: ["router", "peer"], peer: ["router"] } },
  },
  timestamping: { enabled: { router: true, peer: true, client: true } },
  queries_default_timeout: 600000,
}"""
"""Session of a node of rmw_zenoh: it meets others through the router, then they talk directly. Timeout: milliseconds,
also of the query for latched messages.
"""


class ZenohLink:
    """A `Link` on zenoh. Raises DriverError if the session cannot be opened."""

    serves_services = True

    def __init__(self, names: NodeNames, domain: int) -> None:
        self._names, self._domain = names, domain
        try:
            self._session = zenoh.open(_session_config())
        except (zenoh.ZError, ValueError, OSError) as error:
            raise DriverError(f"zenoh: {' '.join(str(error).split())}") from error
        routers = len(self._session.info.routers_zid())
        found = "" if routers else "; no router yet, run: ros2 run rmw_zenoh_cpp rmw_zenohd"
        self.description = f"zenoh, domain {domain}{found}"
        self._numbers = itertools.count()
        self._lock = threading.Lock()
        self._keep: list[Any] = []  # entities end when they are garbage
        self._declare_token("NN", None)

    def publish(self, topic: str, msgtype: str, qos: QoS) -> Put:
        """Advertise a topic, see `Link`."""
        key = self._key(topic, msgtype, _type_hash(msgtype))
        options: dict[str, Any] = {"congestion_control": zenoh.CongestionControl.DROP, "publisher_detection": True}
        if qos.latched:
            options["cache"] = zenoh.ext.CacheConfig(max_samples=qos.depth)
        publisher = zenoh.ext.declare_advanced_publisher(self._session, key, **options)
        self._keep.append(publisher)
        self._declare_token("MP", (topic, msgtype, _type_hash(msgtype), qos))
        source, numbers = uuid.uuid4().bytes, itertools.count(1)

        def put(data: bytes) -> None:
            publisher.put(data, attachment=_attachment(next(numbers), source))

        return put

    def subscribe(self, topic: str, msgtype: str, qos: QoS, receive: Receive) -> None:
        """Subscribe to a topic, see `Link`."""
        key = self._key(topic, msgtype, _type_hash(msgtype))
        options: dict[str, Any] = {"subscriber_detection": True, "allowed_origin": zenoh.Locality.REMOTE}
        if qos.latched:
            options["history"] = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=qos.depth)
        subscriber = zenoh.ext.declare_advanced_subscriber(
            self._session, key, lambda sample: receive(sample.payload.to_bytes()), **options
        )
        self._keep.append(subscriber)
        self._declare_token("MS", (topic, msgtype, _type_hash(msgtype), qos))

    def serve(self, service: str, srvtype: str, answer: Answer) -> None:
        """Offer a service, see `Link`. One request is answered at a time."""
        key = self._key(service, srvtype, _distribution_hash(service_hash(srvtype)))

        def reply(query: zenoh.Query) -> None:
            payload, attachment = query.payload, query.attachment
            if payload is None or attachment is None:
                return
            number, _, size = struct.unpack_from("<qqB", attachment.to_bytes())
            source = attachment.to_bytes()[17 : 17 + size]
            with self._lock:
                response = answer(payload.to_bytes())
            query.reply(key, response, attachment=_attachment(number, source))

        self._keep.append(self._session.declare_queryable(key, reply, complete=True))
        self._declare_token("SS", (service, srvtype, _distribution_hash(service_hash(srvtype)), QoS()))

    def close(self) -> None:
        """Close the session."""
        self._session.close()  # type: ignore[no-untyped-call]

    def _key(self, name: str, msgtype: str, type_hash: str) -> str:
        return f"{self._domain}/{name.strip('/')}/{mangled_type(msgtype)}/{type_hash}"

    def _declare_token(self, kind: str, endpoint: tuple[str, str, str, QoS] | None) -> None:
        """Announce the node, or an endpoint of it: name, type, hash of the type, quality of service."""
        number, names = next(self._numbers), self._names
        parts = ["@ros2_lv", str(self._domain), str(self._session.zid()), "0", str(number), kind, "%"]
        parts += [_escaped(names.namespace), names.node]
        if endpoint is not None:
            name, msgtype, type_hash, qos = endpoint
            parts += [_escaped(name), mangled_type(msgtype), type_hash, _qos_text(qos)]
        self._keep.append(self._session.liveliness().declare_token("/".join(parts)))


def _session_config() -> zenoh.Config:
    """Return the session's configuration: the usual one or that of the environment. Raises DriverError, ZError."""
    file = os.environ.get("ZENOH_SESSION_CONFIG_URI", "").strip()
    if file and not Path(file).is_file():
        raise DriverError(f"ZENOH_SESSION_CONFIG_URI={file}: no such file")
    config = zenoh.Config.from_file(file) if file else zenoh.Config.from_json5(SESSION)
    for setting in filter(None, os.environ.get("ZENOH_CONFIG_OVERRIDE", "").split(";")):
        key, equals, value = setting.partition("=")
        if not equals:
            raise DriverError(f"ZENOH_CONFIG_OVERRIDE: {setting!r} must have the form KEY=VALUE")
        config.insert_json5(key.strip(), value.strip())
    return config


def _type_hash(msgtype: str) -> str:
    return _distribution_hash(type_store("cdr").hash_rihs01(msgtype))


def _distribution_hash(type_hash: str) -> str:
    """Return a type's hash as the sourced distribution has it in keys: Humble does not know hashes."""
    return "TypeHashNotSupported" if os.environ.get("ROS_DISTRO") == "humble" else type_hash


def _attachment(number: int, source: bytes) -> bytes:
    """Return what accompanies each message: its number, its time in nanoseconds, and the sender's identifier."""
    return struct.pack("<qqB", number, time.time_ns(), len(source)) + source


def _escaped(name: str) -> str:
    return name.replace("/", "%")


def _qos_text(qos: QoS) -> str:
    """Return the quality of service as tokens have it, with the values of ROS's enumerations; empty: the default."""
    return f"{'' if qos.reliable else 2}:{1 if qos.latched else ''}:,{qos.depth}:,:,:,,"
