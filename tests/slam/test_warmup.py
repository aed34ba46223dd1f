"""After a warm-up nothing is compiled, neither by another one nor by a run; its two processes do most of it."""

import subprocess
import sys

COMPILED = """
import gc
from numba.core.registry import CPUDispatcher
import slam
from drivers.simulation import Simulation

def compiled():
    ours = [d for d in gc.get_objects() if isinstance(d, CPUDispatcher)
            and d.py_func.__module__.split(".")[0] in ("slam", "features")]
    return {(d.py_func.__module__, d.py_func.__name__, str(signature)) for d in ours for signature in d.signatures}
"""

RUN = """
slam.warm_up()
before = compiled()
slam.warm_up()
again = compiled()
mapper = slam.Slam()
for message in Simulation("office", duration=12.0):
    mapper.add(message)
mapper.finish()
print(len(before) > 5, sorted(again - before), sorted(compiled() - again))
"""


def test_nothing_is_compiled_after_the_warm_up() -> None:
    answer = subprocess.run([sys.executable, "-c", COMPILED + RUN], capture_output=True, text=True, timeout=250)
    assert answer.stderr == ""
    assert answer.stdout == "True [] []\n"


PARTS = """
from slam.warmup import compile_estimation, compile_preprocessing

compile_preprocessing()
first = compiled()
compile_estimation()
both = compiled()
slam.warm_up()
print(len(first) / len(compiled()), len(both) / len(compiled()))
"""


def test_the_processes_of_the_first_compilation_share_the_work() -> None:
    answer = subprocess.run([sys.executable, "-c", COMPILED + PARTS], capture_output=True, text=True, timeout=250)
    assert answer.stderr == ""
    first, both = map(float, answer.stdout.split())
    assert 0.1 < first < 0.7
    assert both > 0.9
