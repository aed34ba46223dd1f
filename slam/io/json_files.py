"""Read and write files of standard JSON."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import MapError, first_line


def read_json(path: Path) -> Any:
    """Read a JSON file. Raises MapError naming the file if it cannot be read or is not JSON."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise MapError(f"{path}: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise MapError(f"{path}: is not JSON: {first_line(error)}") from error


def write_json(path: Path, data: dict[str, Any], indent: int = 2) -> None:
    """Write `data` as standard JSON: NumPy numbers as plain ones, NaN and infinity as null. Raises OSError."""
    path.write_text(json.dumps(to_json_types(data), indent=indent, allow_nan=False) + "\n", encoding="utf-8")


def to_json_types(value: Any) -> Any:
    """Return `value` made of JSON's types only; other objects become strings."""
    if isinstance(value, dict):
        return {str(name): to_json_types(item) for name, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return to_json_types(value.tolist())
    if isinstance(value, list | tuple):
        return [to_json_types(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if isinstance(value, str | int | float | None) else str(value)
