"""Keyframes are read back as they were written."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slam.errors import MapError
from slam.events import Finished
from slam.io.keyframes_csv import COLUMNS, read_keyframes, write_keyframes


def test_keyframes_are_read_back_with_their_covariances(tmp_path: Path, finished: Finished) -> None:
    random = np.random.default_rng(3).normal(0, 0.01, (len(finished.keyframes), 3, 3))
    covariance = random @ random.transpose(0, 2, 1)
    covariance[2] = np.nan
    write_keyframes(tmp_path / "a.csv", replace(finished.keyframes, covariance=covariance))
    read = read_keyframes(tmp_path / "a.csv")
    np.testing.assert_allclose(read.stamps, finished.keyframes.stamps, atol=1e-6)
    np.testing.assert_allclose(read.poses, finished.keyframes.poses, atol=1e-6)
    np.testing.assert_allclose(read.covariance, covariance, rtol=1e-8)
    sigma = read.position_sigma()
    assert np.isnan(sigma[2])
    for k in (0, 1, 3, 4, 5):
        assert sigma[k] == pytest.approx(np.sqrt(np.linalg.eigvalsh(covariance[k, :2, :2]).max()))


@pytest.mark.parametrize(
    ("column", "value", "message"), [("x", "1e300", "the pose is beyond"), ("y", "nan", "not all values are finite")]
)
def test_the_line_of_an_impossible_pose_is_named(
    tmp_path: Path, finished: Finished, column: str, value: str, message: str
) -> None:
    file = tmp_path / "a.csv"
    write_keyframes(file, finished.keyframes)
    header, *lines = file.read_text().splitlines()
    cells = lines[1].split(",")
    cells[COLUMNS.index(column)] = value
    file.write_text("\n".join([header, lines[0], ",".join(cells), *lines[2:], ""]))
    with pytest.raises(MapError, match=rf"a\.csv:3: {message}"):
        read_keyframes(file)
