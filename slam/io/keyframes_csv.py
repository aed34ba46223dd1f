"""Write and read `keyframes.csv`: the keyframes' poses and covariances, one keyframe per line below a header."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..bounds import MAX_LENGTH
from ..errors import MapError
from ..mapping.map_features import Keyframes

COLUMNS = ("stamp", "x", "y", "heading", "xx", "xy", "xh", "yy", "yh", "hh")
UPPER_TRIANGLE = np.triu_indices(3)


def write_keyframes(path: Path, keyframes: Keyframes) -> None:
    """Write the keyframes: microseconds, micrometres, and nine digits of the covariances' upper triangles."""
    lines = [",".join(COLUMNS)]
    upper = keyframes.covariance[:, UPPER_TRIANGLE[0], UPPER_TRIANGLE[1]]
    for stamp, pose, values in zip(keyframes.stamps.tolist(), keyframes.poses.tolist(), upper.tolist(), strict=True):
        numbers = [f"{stamp:.6f}", *(f"{value:z.6f}" for value in pose[:2]), f"{pose[2]:z.9f}"]
        lines.append(",".join([*numbers, *(f"{value:.9g}" for value in values)]))
    path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")


def read_keyframes(path: Path | str) -> Keyframes:
    """Read keyframes. Raises MapError naming the file and the line."""
    try:
        header, *lines = Path(path).read_text(encoding="ascii").splitlines() or [""]
    except OSError as error:
        raise MapError(f"{path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise MapError(f"{path}: is not a text file") from error
    if tuple(header.split(",")) != COLUMNS:
        raise MapError(f"{path}:1: the header is not {','.join(COLUMNS)}")
    rows = np.empty((len(lines), len(COLUMNS)))
    for number, line in enumerate(lines, start=2):
        try:
            rows[number - 2] = [float(word) for word in line.split(",")]
        except ValueError as error:
            raise MapError(f"{path}:{number}: expected {len(COLUMNS)} numbers") from error
        if not np.isfinite(rows[number - 2, :4]).all():
            raise MapError(f"{path}:{number}: not all values are finite")
        if np.abs(rows[number - 2, 1:4]).max() > MAX_LENGTH:
            raise MapError(f"{path}:{number}: the pose is beyond {MAX_LENGTH:g} m")
    covariance = np.empty((len(rows), 3, 3))
    covariance[:, UPPER_TRIANGLE[0], UPPER_TRIANGLE[1]] = rows[:, 4:]
    covariance[:, UPPER_TRIANGLE[1], UPPER_TRIANGLE[0]] = rows[:, 4:]
    return Keyframes(rows[:, 0], rows[:, 1:4], covariance)
