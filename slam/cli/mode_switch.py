"""Switching between mapping and localisation during a run: by a key, the page, SIGUSR2 or a service of ROS 2."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Self

from ..errors import MapError
from .console import print_message
from .terminal_keys import TerminalKeys

if TYPE_CHECKING:
    from ..pipeline import Slam

MODE_KEY = b"l"


class ModeSwitch:
    """Context in which the mode of a run is changed by `request`, and on SIGUSR2 or the key `l` to the other one.

    switched  called with True when the map is only localised in from then on, with False when it is extended, and at
              the beginning; with what prevents a change as text, else with an empty text
    """

    def __init__(self) -> None:
        self.switched: Callable[[bool, str], None] = lambda frozen, problem: None
        self._slam: Slam | None = None
        self._requested: Callable[[bool], bool] | None = None  # the mode that follows the present one

    def begin(self, slam: Slam, keys: TerminalKeys) -> Self:
        """Act on the run of `slam` from now on, also on the keys of a terminal; to be used as a context."""
        self._slam = slam
        keys.add(self._handle_keys)
        return self

    def __enter__(self) -> Self:
        assert self._slam is not None
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGUSR2, lambda *_: self.toggle())
        self.switched(self._slam.frozen, "")
        self.poll()  # a mode that was requested before holds from the first scan on
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGUSR2, signal.SIG_IGN)  # one that was sent before must not end the process

    def continued(self) -> ModeSwitch:
        """Return the switch for a run that continues this one, which begins in the mode in which this one has ended."""
        following = ModeSwitch()
        if self._slam is not None and self._slam.frozen:
            following.request(True)
        return following

    def request(self, frozen: bool) -> None:
        """Only localise in the map (`frozen`) or extend it, from the next `poll` on. May be called from any thread."""
        self._requested = lambda _: frozen

    def toggle(self) -> None:
        """Change to the other mode at the next `poll`. May be called from any thread."""
        self._requested = lambda frozen: not frozen

    def poll(self) -> None:
        """Change the mode if that was requested. To be called between two messages."""
        requested, self._requested = self._requested, None
        if requested is not None and self._slam is not None:
            self.set(requested(self._slam.frozen))

    def set(self, frozen: bool) -> bool:
        """Change the mode at once, between two messages; return False if that is not possible, and print why."""
        assert self._slam is not None
        problem = ""
        try:
            if frozen:
                self._slam.freeze()
            else:
                self._slam.unfreeze()
            print_message(f"the map is {'only localised in' if frozen else 'extended'} from now on")
        except MapError as error:
            problem = f"the mode is not changed: {error}"
            print_message(problem)
        self.switched(self._slam.frozen, problem)
        return not problem

    @property
    def extends_map(self) -> bool:
        """True if the run extends its map or did before, see `Slam.extends_map`."""
        return self._slam is not None and self._slam.extends_map

    def _handle_keys(self, keys: bytes) -> None:
        if MODE_KEY in keys.lower():
            self.toggle()
