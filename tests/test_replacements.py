"""A replacement is gone after its test, also from modules that were imported meanwhile."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

from drivers import se2

from .replacements import replaced


def test_a_module_imported_meanwhile_gets_the_real_function_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "imported_meanwhile.py").write_text("from drivers.se2 import compose\n")
    monkeypatch.syspath_prepend(tmp_path)
    real = se2.compose
    try:
        with replaced(se2, "compose", replacement := object()):
            module = importlib.import_module("imported_meanwhile")
            assert module.compose is se2.compose is replacement
        assert module.compose is se2.compose is real
    finally:
        sys.modules.pop("imported_meanwhile", None)
