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
from ...run_setup import RunSetup
from ..console import print_message
from ..mode_switch import ModeSwitch
from ..run_controls import RunControls
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
                    self._go_on_without_map(error)
                    continue
                if not (isinstance(self.control.pending, Save) or self._is_behind_clock):
                    return lines
                following = self._continued(start, target)
                if isinstance(self.control.pending, Save):
                    self._save(target)
                else:
                    self._follow_clock()
                start, overwrite, modes = following, True, modes.continued()

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
        if start.frozen and start.resumed is not None:  # the run changes it, and another one may begin with it
            start = replace(start, resumed=start.resumed.copy())
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
        controls = RunControls(modes=modes)
        result = run_slam(
            run_input, start, target, overwrite=overwrite, review=review, picture=False, controls=controls
        )
        return format_summary(result, target)

    @property
    def _is_behind_clock(self) -> bool:
        """True if a run has to begin because the clock was set back."""
        return self.receiver.clock_was_set_back and not self.receiver.stopped

    def _follow_clock(self) -> None:
        self.receiver.begin_again()
        print_message("the clock was set back; a new run continues the map when the robot is recognised in it")

    def _go_on_without_map(self, error: MapError) -> None:
        """State why nothing is saved, if another run begins nevertheless; else raise the error."""
        if isinstance(self.control.pending, Save):
            print_message(f"serialize_map: the map is not finished: {error}")
            self.control.answer(False)
        elif self._is_behind_clock:
            self._follow_clock()
        else:
            raise error

    def _restarted(self, start: RunSetup) -> RunSetup:
        """Return the setup of the run that was requested, or that the clock requires where the map does not change."""
        request = self.control.pending
        if not isinstance(request, Restart):
            self._follow_clock()
            return replace(start, pose=None)
        self.receiver.discard()
        self.control.answer(True)
        print_message("the map is discarded; a new run begins")
        plan = start.plan if request.session is None else None  # a map without a session begins as the first one did
        return RunSetup(start.config, request.session, request.frozen, request.pose, plan)

    def _continued(self, start: RunSetup, target: Path) -> RunSetup:
        """Return the setup of a run that continues the finished one."""
        if start.plan is not None:
            print_message("the run goes on with what the map has of the plan, and without the plan")
        return replace(start, resumed=read_session(target, solve=False), frozen=False, pose=None, plan=None)

    def _save(self, target: Path) -> None:
        """Copy the finished run to where it was requested."""
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
        self.control.answer(succeeded)
