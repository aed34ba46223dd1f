"""After a warm-up nothing is compiled, neither by another one nor by runs; its two processes do most of it."""

import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import slam
from drivers import Odometry
from slam.preprocessing.extraction import warn_of_compilation

COMPILED = """
import gc, sys
from dataclasses import replace
from pathlib import Path
from numba.core.registry import CPUDispatcher
import slam
from drivers.simulation import LIDAR_MODELS, Simulation
from slam.config import Config, config_to_toml
from slam.io.sessions import read_session, write_session
from tests.slam.estimation.test_map_parts import elsewhere

def compiled():
    gc.unfreeze()  # a command has frozen what it has loaded
    ours = [d for d in gc.get_objects() if isinstance(d, CPUDispatcher)
            and d.py_func.__module__.split(".")[0] in ("slam", "features", "drivers")
            and not d.py_func.__module__.startswith("drivers.simulation")]
    return {(d.py_func.__module__, d.py_func.__name__, str(signature)) for d in ours for signature in d.signatures}
"""

RUN = """
slam.warm_up()
before = compiled()
slam.warm_up()
again = compiled()
mapper = slam.Slam()
for message in Simulation("office", duration=12.0, lidar=LIDAR_MODELS["short"]):
    mapper.add(message)
mapper.finish()
mapped = compiled()
(directory := Path(sys.argv[1])).joinpath("config.toml").write_text(config_to_toml(Config()))
write_session(directory, mapper.session)
for frozen in (False, True):
    continued = slam.Slam(resumed=read_session(directory), frozen=frozen)
    for message in elsewhere("office", "room", 6.0, rate=5.0):
        continued.add(replace(message, stamp=message.stamp + 1000.0))
print(len(before) > 5, sorted(again - before), sorted(mapped - again), sorted(compiled() - mapped))
"""


def test_a_run_that_compiles_names_the_warm_up_once(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slam.preprocessing.extraction.is_compiled", lambda: False)
    warn_of_compilation.cache_clear()
    for _ in range(2):
        slam.Slam().add(Odometry(0.0, np.zeros(3)))
    (record,) = caplog.records
    assert record.levelname == "WARNING"
    assert "slam.warm_up()" in record.message
    warn_of_compilation.cache_clear()


def test_a_run_that_is_compiled_logs_nothing(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slam.preprocessing.extraction.is_compiled", lambda: True)
    warn_of_compilation.cache_clear()
    slam.Slam().add(Odometry(0.0, np.zeros(3)))
    assert not caplog.records


def test_nothing_is_compiled_after_the_warm_up(tmp_path: Path) -> None:
    """Neither by a second warm-up, nor by a run, nor by one that continues a session or localises in it, and in which
    the robot is carried to another place.
    """
    command = [sys.executable, "-c", COMPILED + RUN, str(tmp_path)]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=250)
    assert answer.stderr == ""
    assert answer.stdout == "True [] [] []\n"


COMMAND = """
from slam.cli import main
from slam.warmup import compile_estimation, compile_preprocessing
from tests.drivers.timing.test_beam_order import carmen_log

directory = Path(sys.argv[1])
log = carmen_log(directory / "office.clf", Simulation("office", seed=3, duration=20.0))
compile_preprocessing()
compile_estimation()
slam.warm_up()
before = compiled()
sys.argv = ["wclm", "run", str(log), "--out", str(directory / "map")]
try:
    main()
finally:  # it exits
    print(sorted(compiled() - before))
"""


@pytest.mark.slow
def test_nothing_is_compiled_to_map_a_recording_with_a_review_log(tmp_path: Path) -> None:
    command = [sys.executable, "-c", COMPILED + COMMAND, str(tmp_path)]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=250)
    assert answer.stdout.splitlines()[-1] == "[]", answer.stderr


PARTS = """
from slam.warmup import compile_estimation, compile_preprocessing

compile_preprocessing()
first = compiled()
compile_estimation()
both = compiled()
slam.warm_up()
print(len(first) / len(compiled()), len(both) / len(compiled()))
"""


@pytest.mark.slow
def test_the_processes_of_the_first_compilation_share_the_work() -> None:
    answer = subprocess.run([sys.executable, "-c", COMPILED + PARTS], capture_output=True, text=True, timeout=250)
    assert answer.stderr == ""
    first, both = map(float, answer.stdout.split())
    assert 0.1 < first < 0.7
    assert both > 0.9


SLEEPING = "import time; time.sleep(60)"


def test_a_signal_ends_the_processes_that_compile(monkeypatch: pytest.MonkeyPatch) -> None:
    """They went on for a minute with both processors, and held the terminal."""
    started: list[subprocess.Popen[bytes]] = []
    waits: list[subprocess.Popen[bytes]] = []

    class Process(subprocess.Popen[bytes]):
        def __init__(self, command: list[str]) -> None:
            super().__init__([*command[:2], SLEEPING])
            started.append(self)

        def wait(self, timeout: float | None = None) -> int:
            if not waits:
                waits.append(self)
                raise KeyboardInterrupt
            return super().wait(timeout)

    monkeypatch.setattr("slam.warmup.is_compiled", lambda: False)
    monkeypatch.setattr("slam.warmup.subprocess", SimpleNamespace(Popen=Process))
    with pytest.raises(KeyboardInterrupt):
        slam.warm_up()
    assert [process.returncode for process in started] == [-signal.SIGKILL] * 2
