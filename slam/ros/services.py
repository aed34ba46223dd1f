"""Services of the node, with the names and types of slam_toolbox."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from drivers.errors import DriverError, SlamError
from drivers.ros2 import services
from drivers.ros2.encoder import NodeEncoder
from drivers.ros2.link import Link
from drivers.ros2.names import NodeNames
from drivers.ros2.services import decode_request, encode_response

from ..errors import OutputError
from ..io.exports import Occupancy, write_pgm, write_pgm_yaml
from ..io.unfinished_file import unfinished_file
from .outputs import message_grid
from .run_control import Restart, RunControl, Save, SetMode

if TYPE_CHECKING:
    from ..io.sessions import StoredSession

SUCCESS, NO_MAP, FAILURE = 0, 1, 255
"""Results of services, as slam_toolbox defines them."""
START_AT_FIRST_NODE, START_AT_POSE, LOCALIZE = 1, 2, 3
"""Match types of deserialize_map: the robot is near the first pose in the map, or near the one that is given; the last
one leaves the map unchanged.
"""


class Receiver(Protocol):
    """Receiver of scans that can be paused."""

    paused: bool


class NodeServices:
    """Services of a node, offered from construction on; one that the link cannot offer is reported.

    current_grid  returns the stamp of the map and its occupancy grid; None if there is none yet
    read_session  reads the session in a directory; raises SlamError
    report        called with one line of text about each request
    """

    def __init__(
        self,
        link: Link,
        names: NodeNames,
        map_frame: str,
        receiver: Receiver,
        control: RunControl,
        *,
        current_grid: Callable[[], tuple[float, Occupancy] | None],
        read_session: Callable[[Path], StoredSession],
        report: Callable[[str], None],
    ) -> None:
        self._map_frame, self._receiver, self._control = map_frame, receiver, control
        self._current_grid, self._read_session, self._report = current_grid, read_session, report
        self._encoder = NodeEncoder()
        for name, srvtype, call in (
            ("dynamic_map", services.GET_MAP, self._get_map),
            ("save_map", services.SAVE_MAP, self._save_map),
            ("serialize_map", services.SERIALIZE_MAP, self._serialize),
            ("deserialize_map", services.DESERIALIZE_MAP, self._deserialize),
            ("pause_new_measurements", services.PAUSE, self._pause),
            ("reset", services.RESET, self._reset),
            ("set_localization_mode", services.SET_BOOL, self._set_mode),
        ):
            try:
                link.serve(names.resolve(f"slam_toolbox/{name}"), srvtype, self._answer(srvtype, call))
            except DriverError as error:
                report(f"service is not offered: {error}")

    def _answer(self, srvtype: str, call: Callable[[Any], dict[str, Any]]) -> Callable[[bytes], bytes]:
        return lambda request: encode_response(srvtype, call(decode_request(srvtype, request)))

    def _get_map(self, _: Any) -> dict[str, Any]:
        current = self._current_grid()
        if current is None:
            return {}
        stamp, occupancy = current
        return {"map": self._encoder.grid_message(stamp, self._map_frame, message_grid(occupancy))}

    def _save_map(self, request: Any) -> dict[str, Any]:
        """Write NAME.pgm and NAME.yaml for the map server; existing files are replaced."""
        current, name = self._current_grid(), request.name.data or "map"
        if current is None:
            self._report("save_map: there is no map yet")
            return {"result": NO_MAP}
        try:
            picture, settings = _path(f"{name}.pgm"), _path(f"{name}.yaml")
            with unfinished_file(picture, True) as pixels, unfinished_file(settings, True) as yaml:
                write_pgm(pixels, current[1])
                write_pgm_yaml(yaml, current[1], image=picture.name)
        except SlamError as error:
            self._report(f"save_map: {error}")
            return {"result": FAILURE}
        self._report(f"save_map: {picture}, {settings}")
        return {"result": SUCCESS}

    def _serialize(self, request: Any) -> dict[str, Any]:
        if not request.filename:
            self._report("serialize_map: no name of a directory")
            return {"result": FAILURE}
        try:
            directory = _path(request.filename)
        except OutputError as error:
            self._report(f"serialize_map: {error}")
            return {"result": FAILURE}
        return {"result": SUCCESS if self._control.request(Save(directory)) else FAILURE}

    def _deserialize(self, request: Any) -> dict[str, Any]:
        """Begin with a session; if it cannot be read, the present run goes on. The response has no result."""
        try:
            session = self._read_session(_path(request.filename))
        except SlamError as error:
            self._report(f"deserialize_map: {error}")
        else:
            given, pose = request.initial_pose, None
            if request.match_type in (START_AT_POSE, LOCALIZE):
                pose = np.array([given.x, given.y, given.theta])
            elif request.match_type == START_AT_FIRST_NODE:
                pose = session.first_pose
            self._control.request(Restart(session, request.match_type == LOCALIZE, pose))
        return {}

    def _pause(self, _: Any) -> dict[str, Any]:
        self._receiver.paused = not self._receiver.paused
        self._report(f"new measurements are {'paused' if self._receiver.paused else 'used again'}")
        return {"status": self._receiver.paused}

    def _set_mode(self, request: Any) -> dict[str, Any]:
        """Only localise if `data` is true, else map."""
        frozen = bool(request.data)
        succeeded = self._control.request(SetMode(frozen))
        done = f"the map {'is only localised in' if frozen else 'is extended'} from now on"
        return {"success": succeeded, "message": done if succeeded else "not possible; the node has printed why"}

    def _reset(self, request: Any) -> dict[str, Any]:
        self._receiver.paused = bool(request.pause_new_measurements)
        return {"result": SUCCESS if self._control.request(Restart(None, False)) else FAILURE}


def _path(name: str) -> Path:
    """Return the path with a name from another computer; raises OutputError if no file can have it."""
    try:
        os.lstat(name)
    except ValueError as error:
        raise OutputError(f"{name!r}: no file can have this name") from error
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            raise OutputError(f"{name[:40]}...: no file can have a name as long") from error
    return Path(name)
