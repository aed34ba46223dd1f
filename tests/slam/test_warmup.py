"""After a warm-up nothing is left to compile, whatever the robot drives into."""

import subprocess
import sys
import time

import pytest

import slam
from slam.cli.console import print_if_slow

RUN = """
import gc
from numba.core.registry import CPUDispatcher
import slam
from drivers.simulation import Simulation

def compiled():
    ours = [d for d in gc.get_objects() if isinstance(d, CPUDispatcher)
            and d.py_func.__module__.split(".")[0] in ("slam", "features")]
    return {(d.py_func.__module__, d.py_func.__name__, str(signature)) for d in ours for signature in d.signatures}

slam.warm_up()
before = compiled()
mapper = slam.Slam()
for message in Simulation("office", duration=12.0):
    mapper.add(message)
mapper.finish()
print(len(before) > 5, sorted(compiled() - before))
"""


def test_nothing_is_compiled_after_the_warm_up() -> None:
    answer = subprocess.run([sys.executable, "-c", RUN], capture_output=True, text=True, timeout=200)
    assert answer.stderr == ""
    assert answer.stdout == "True []\n"


def test_the_second_warm_up_costs_next_to_nothing() -> None:
    slam.warm_up()
    before = time.perf_counter()
    slam.warm_up()
    assert time.perf_counter() - before < 1.0


def test_only_what_is_slow_is_spoken_of(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slam.cli.console.SLOW", 0.05)
    with print_if_slow("compiling"):
        pass
    time.sleep(0.1)
    assert capsys.readouterr().err == ""
    with print_if_slow("compiling"):
        time.sleep(0.2)
    assert capsys.readouterr().err == "wclm: compiling\n"
