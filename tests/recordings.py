"""Locate public recordings for tests; a test whose recording is missing is skipped.

The recordings are in the folder that the environment variable WCLM_DATASETS names, else in `../shared/datasets` beside
the project.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DATASETS = Path(os.environ.get("WCLM_DATASETS", ROOT.parent / "shared" / "datasets"))


def dataset_file(relative: str) -> Path:
    """Return the path of a file below the datasets folder, such as `g2o/m3500.g2o`; skip the test if it is missing."""
    path = DATASETS / relative
    if not path.exists():
        pytest.skip(f"{path} is missing; set WCLM_DATASETS to the folder that contains {relative}")
    return path


def recording_folder(name: str, *suffixes: str) -> Path:
    """Return the folder of a recording that has the files `NAME.SUFFIX`; skip the test if one is missing."""
    for suffix in suffixes:
        recording_file(name, suffix)
    return DATASETS / name


def recording_file(name: str, suffix: str = "clf") -> Path:
    """Return the path of `NAME/NAME.SUFFIX`; skip the test if it is missing."""
    return dataset_file(f"{name}/{name}.{suffix}")
