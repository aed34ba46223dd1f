"""Compiled functions load no linear algebra of SciPy."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_linear_algebra_of_scipy_is_loaded_by_functions_that_call_it_only(tmp_path: Path) -> None:
    code = """if True:
        import sys
        import numba, numpy
        from drivers import compiled
        assert numba.njit(lambda x: x + 1)(1) == 2
        assert "scipy.linalg" not in sys.modules
        other = numba.njit(lambda a, b: numpy.dot(a, b))  # of another program, with BLAS
        assert other(numpy.ones(3), numpy.ones(3)) == 3.0
        assert "scipy.linalg" in sys.modules
    """
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path)}
    answer = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=250)
    assert answer.returncode == 0, answer.stderr
