import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.simulation import Simulation
from slam import Slam
from slam.config import Config, config_to_toml, load_config
from slam.errors import ConfigurationError


def test_overrides_come_after_the_file(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text("[lidar]\nsigma_range = 0.02\nrange_max = 8.0\n")
    config = load_config(tmp_path / "a.toml", ["lidar.range_max=12", "features.estimator=wclm"])
    assert (config.lidar.sigma_range, config.lidar.range_max) == (0.02, 12.0)
    assert config.features.estimator == "wclm"
    assert config.odometry == Config().odometry


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    config = load_config(overrides=["lidar.mount=[0.1, -1e-9, 3.1]", "lidar.range_max=inf", "lidar.adapt_noise=false"])
    assert math.isinf(config.lidar.range_max)
    for name, each in (("a", config), ("b", Config())):
        (tmp_path / f"{name}.toml").write_text(config_to_toml(each))
        assert load_config(tmp_path / f"{name}.toml") == each


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("lidar.sigma=1", "--set lidar.sigma=1: lidar.sigma: no such setting; known are sigma_range,"),
        ("laser.sigma_range=1", "laser: no such setting; known are lidar, odometry, features"),
        ("lidar.sigma_range=wide", "lidar.sigma_range: input should be a valid number"),
        ("lidar.sigma_range=-1", "lidar.sigma_range: input should be greater than 0"),
        ("lidar.sigma_range=nan", "lidar.sigma_range: "),
        ("odometry.translation_floor=inf", "odometry.translation_floor: input should be a finite number"),
        ("odometry.translation_error=1e9", "odometry.translation_error: input should be less than or equal to 1000"),
        ("odometry.rotation_floor=1e300", "odometry.rotation_floor: input should be less than or equal to 1000"),
        ("lidar.range_max=0.01", "lidar: range_min (0.05) must be less than range_max (0.01)"),
        ("lidar.mount=1,2,3", "lidar.mount: must be a list of three numbers, e.g. [0.1,0,0]"),
        ("lidar.mount=[1,2]", "lidar.mount: must be a list of three numbers, e.g. [0.1,0,0]"),
        ("lidar.mount=[1,2,3,4]", "lidar.mount: must be a list of three numbers, e.g. [0.1,0,0]"),
        ("lidar.range_max=nan", "lidar.range_max: input should be a finite number"),
        ("lidar.delay=inf", "lidar.delay: input should be a finite number"),
        ("lidar.mount=[100.1, 0, 0]", "lidar.mount.0: input should be less than or equal to 100"),
        ("lidar.mount=[0, 0, 90]", "lidar.mount.2: input should be less than or equal to 6.28"),
        ("second_lidar.mount=[0, nan, 0]", "second_lidar.mount.1: input should be a finite number"),
        ("lidar.range_max=true", "lidar.range_max: must not be true or false"),
        ("lidar.delay=true", "lidar.delay: must not be true or false"),
        ("features.estimator=best", "features.estimator: input should be 'wclm-ml'"),
        ("lidar=3", "--set lidar=3: must have the form group.key=value"),
        ("sigma_range=3", "must have the form group.key=value"),
        ("lidar.sigma_range", "must have the form group.key=value"),
    ],
)
def test_a_wrong_override_is_named(override: str, message: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        load_config(overrides=[override])
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("groups", "message"),
    [
        ({"lidar": {"mout": (0.1, 0.0, 0.0)}}, "lidar.mout: no such setting; known are sigma_range,"),
        ({"lidar": {"mount": (0.1, 0.0)}}, "lidar.mount: must be a list of three numbers"),
        ({"laser": {}}, "laser: no such setting; known are lidar,"),
    ],
)
def test_a_wrong_setting_in_python_is_one_line(groups: dict[str, Any], message: str) -> None:
    for create in (Config, lambda **data: Config.model_validate(data)):
        with pytest.raises(ConfigurationError, match=f"^{re.escape(message)}.*$"):
            create(**groups)


@pytest.mark.parametrize("name", ["translation_error", "rotation_walk", "translation_floor", "rotation_floor"])
def test_odometry_may_be_as_uncertain_as_settings_allow(name: str) -> None:
    slam = Slam(load_config(overrides=[f"odometry.{name}=1000"]))
    for message in Simulation("room", seed=4, duration=3.0):
        slam.add(message)
    assert np.isfinite(slam.finish().poses).all()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"[lidar]\nsigma_rang = 0.02\n", "a.toml: lidar.sigma_rang: no such setting"),
        (b'[lidar]\n"a\\nb" = 0.02\n', "a.toml: lidar.a b: no such setting"),
        (b"[lidar]\n" + b"9" * 5000 + b" = 1\n", "9…: no such setting"),
        (b"lidar = 3\n", "a.toml: lidar: must be a group of settings"),
        (b"[lidar\n", "a.toml: invalid TOML: "),
        (b"\xff\xfe", "a.toml: invalid TOML: "),
        (b"lidar = " + 5000 * b"9", "a.toml: invalid TOML: "),
        (b"lidar = " + 5000 * b"[", "a.toml: invalid TOML: "),
    ],
)
def test_a_wrong_file_is_named(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "a.toml").write_bytes(content)
    with pytest.raises(ConfigurationError) as caught:
        load_config(tmp_path / "a.toml")
    assert message in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"a\.toml: No such file"):
        load_config(tmp_path / "a.toml")
    with pytest.raises(ConfigurationError, match="Is a directory"):
        load_config(tmp_path)
