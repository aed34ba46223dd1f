"""The runs of `wclm ros`: one after the other, as its services end them."""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.errors import SlamError

from ...errors import MapError
from ...io.output_dir import OutputDirectory
from ...io.sessions import read_session
from ...ros.run_control import Restart, RestartRequestedError, RunControl, Save
from ..console import print_message
from ..mode_switch import ModeSwitch
from ..run_setup import RunSetup
from ..run_summary import format_summary
from ..slam_run import run_slam
from ..switch_interval import short_switch_interval
from .live_dashboard import LiveDashboard
from .ros_input import DiscardedError, RosInput

if TYPE_CHECKING:
    from drivers.ros2.receiver import RosReceiver

    from ...ros.outputs import NodeOutputs


class RosNode:
    """A node with its topics; `control` takes the requests of its services."""

    def __init__(self, receiver: RosReceiver, outputs: NodeOutputs) -> None:
        self.receiver, self.outputs, self.control = receiver, outputs, RunControl()

    def run(
        self, start: RunSetup, out: Path | None, *, overwrite: bool, review: bool, duration: float | None
    ) -> list[str]:
        """Run until the node is stopped; return the summary of what was written, as lines of text.

        out  output directory; None: nothing is written at the end

        Raises SlamError.
        """
        with tempfile.TemporaryDirectory(prefix="wclm-ros-") as folder, short_switch_interval():
            target, shown, modes = out or Path(folder) / "map", review and out is not None, ModeSwitch()
            while True:
                try:
                    lines = self._run_once(start, target, out is not None, overwrite, shown, duration, modes)
                except DiscardedError:
                    return ["stopped; nothing was written, as there is no --out"]
                except RestartRequestedError:
                    start, modes, overwrite = self._restarted(start), ModeSwitch(), overwrite or target.exists()
                    continue
                except MapError as error:
                    if not isinstance(self.control.pending, Save):
                        raise
                    print_message(f"serialize_map: the map is not finished: {error}")
                    self.control.answer(False)
                    continue
                if not isinstance(self.control.pending, Save):
                    return lines
                start, overwrite, modes = self._saved(start, target), True, modes.continued()

    def _run_once(
        self,
        start: RunSetup,
        target: Path,
        keep: bool,
        overwrite: bool,
        review: bool,
        duration: float | None,
        modes: ModeSwitch,
    ) -> list[str]:
        run_input = RosInput(
            self.receiver,
            self.outputs,
            start,
            duration=duration,
            keep=keep,
            control=self.control,
            modes=modes,
            sinks=(LiveDashboard(),),
        )
        result = run_slam(run_input, start, target, overwrite=overwrite, review=review, picture=False, modes=modes)
        return format_summary(result, target)

    def _restarted(self, start: RunSetup) -> RunSetup:
        """Return the setup of the run that was requested."""
        request = self.control.pending
        assert isinstance(request, Restart)
        self.receiver.discard()
        self.control.answer(True)
        print_message("the map is discarded; a new run begins")
        plan = start.plan if request.session is None else None  # a map without a session begins as the first one did
        return RunSetup(start.config, request.session, request.frozen, request.pose, plan)

    def _saved(self, start: RunSetup, target: Path) -> RunSetup:
        """Copy the finished run to where it was requested; return the setup of the run that continues it."""
        request = self.control.pending
        assert isinstance(request, Save)
        succeeded = False
        try:
            with OutputDirectory(request.directory, overwrite=True) as directory:
                shutil.copytree(target, directory, dirs_exist_ok=True)
            print_message(f"serialize_map: {request.directory}")
            succeeded = True
        except (SlamError, OSError) as error:
            print_message(f"serialize_map: {error}")
        following = replace(start, resumed=read_session(target, solve=False), frozen=False, pose=None, plan=None)
        if start.plan is not None:
            print_message("the run goes on with what the map has of the plan, and without the plan")
        self.control.answer(succeeded)
        return following
