"""How people follow and steer a run while it goes on."""

from __future__ import annotations

from dataclasses import field
from typing import TYPE_CHECKING

from drivers.immutable import immutable

from .mode_switch import ModeSwitch
from .terminal_keys import TerminalKeys

if TYPE_CHECKING:
    from ..visualisation.live_page import PageServer
    from ..visualisation.rerun_log import ViewerServer


@immutable
class RunControls:
    """Connections of a run to people.

    server  where viewers of the review log can connect, if anywhere
    page    page that shows the run, saves the map and changes the mode on request, if any
    keys    keys of the terminal, with the handlers of a live run; the key `s` saves the map
    modes   switch between mapping and localisation of a run that is not finite
    """

    server: ViewerServer | None = None
    page: PageServer | None = None
    keys: TerminalKeys = field(default_factory=TerminalKeys)
    modes: ModeSwitch = field(default_factory=ModeSwitch)
