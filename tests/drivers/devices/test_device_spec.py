"""Device specs as typed by a user."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import drivers
from drivers import DriverError
from drivers.devices.device_spec import DEVICE_KINDS, SpecError, is_device_spec, parse_device, parse_devices
from drivers.devices.registry import make_device
from drivers.devices.wheel_base import drive_geometry


def test_options_of_a_lidar_are_converted() -> None:
    spec = parse_device("rplidar:/dev/ttyUSB0?baud=256000&mode=Dense%20Boost&mount=0.1,0,-1.5&upside_down=1&serial=0A")
    assert (spec.kind, spec.address, spec.is_lidar, spec.tcp) == ("rplidar", "/dev/ttyUSB0", True, None)
    np.testing.assert_array_equal(spec.options["mount"], [0.1, 0.0, -1.5])
    assert spec.options["mode"] == "Dense Boost"
    assert spec.options["upside_down"] is True
    assert make_device(spec).bauds == (256000,)


@pytest.mark.parametrize(
    ("address", "tcp"),
    [("10.0.0.5:10940", ("10.0.0.5", 10940)), ("[::1]:80", ("::1", 80)), ("auto", None), ("tape:a.tape", None)],
)
def test_addresses_are_classified(address: str, tcp: tuple[str, int] | None) -> None:
    spec = parse_device(f"scip:{address}")
    assert spec.address == address
    assert spec.tcp == tcp


def test_several_devices_are_joined_by_a_plus_sign() -> None:
    specs = parse_devices("  ld06:/dev/a+b  +  create2:/dev/c ")
    assert [(spec.kind, spec.address) for spec in specs] == [("ld06", "/dev/a+b"), ("create2", "/dev/c")]


def test_wheel_geometry_follows_from_radius_and_ticks() -> None:
    spec = parse_device("wheels:/dev/a?wheel_radius=0.03,0.031&ticks=1000,-1000&track=0.2")
    drive = drive_geometry(spec.kind, spec.options)
    assert drive.left == pytest.approx(2 * np.pi * 0.03 / 1000)
    assert drive.right == pytest.approx(-2 * np.pi * 0.031 / 1000)
    assert drive.track == 0.2
    assert drive_geometry("create2", {"track": 0.3}).track == 0.3


@pytest.mark.parametrize(("kind", "radius"), [("create2", 0.036), ("kobuki", 0.035)])
def test_the_radius_that_calibration_has_found_is_used_with_the_ticks_of_the_kind(kind: str, radius: float) -> None:
    usual = drive_geometry(kind, {})
    worn = drive_geometry(kind, parse_device(f"{kind}:/dev/a?wheel_radius={0.97 * radius},{radius}").options)
    assert (worn.left, worn.right) == pytest.approx((0.97 * usual.left, usual.right))
    backwards = drive_geometry(kind, parse_device(f"{kind}:/dev/a?ticks=-{2 * np.pi * radius / usual.left}").options)
    assert (backwards.left, backwards.right) == pytest.approx((-usual.left, -usual.right))


@pytest.mark.parametrize(
    ("text", "because"),
    [
        ("lidar:/dev/a", "not a device; there are rplidar:PORT"),
        ("ydlidar:/dev/a", "wheels:PORT; other lidars can be used by wclm ros, if they have a driver for ROS 2"),
        ("rplidar", "not a device"),
        ("rplidar:", "the port is missing"),
        ("rplidar:/dev/a?speed=3", "no option 'speed'; it has baud"),
        ("rplidar:/dev/a?baud=fast", "baud=fast"),
        ("rplidar:/dev/a?baud=-1", "above 0"),
        ("ld06:/dev/a?mode=x", "no option 'mode'"),
        ("ld06:/dev/a?mount=1,2", "3 numbers"),
        ("ld06:/dev/a?mount=1,2,nan", "3 numbers"),
        ("ld06:/dev/a?upside_down=yes", "1 (yes) or 0 (no)"),
        ("create2:/dev/a?ticks=0", "one number, or"),
        ("wheels:/dev/a", "needs wheel_radius, ticks, track; for example wheels:/dev/a?wheel_radius="),
        ("arduino:/dev/a?track=0.2&ticks=10", "needs wheel_radius;"),
        ("ld06:/dev/a + kobuki:/dev/a", "used twice"),
        ("ld06:/dev/a + /dev/b", "/dev/b: not a device"),
    ],
)
def test_errors_of_specs_state_what_is_allowed(text: str, because: str) -> None:
    with pytest.raises(SpecError) as caught:
        parse_devices(text)
    assert because in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("devices", "because"),
    [
        ("create2:/dev/a + kobuki:/dev/b", "2 wheel bases are given, and at most 1 can be used"),
        ("ld06:/dev/a + ld06:/dev/b + rplidar:/dev/c", "3 lidars are given, and at most 2"),
    ],
)
def test_a_robot_has_two_lidars_and_one_base_at_most(devices: str, because: str) -> None:
    """The odometry of two bases would be mixed."""
    with pytest.raises(SpecError, match=because):
        drivers.open(devices)


@settings(deadline=None)
@given(st.text(max_size=40), st.sampled_from(["", "ld06:", "rplidar:/dev/a?", "wheels:/dev/a?ticks="]))
def test_any_text_gives_devices_or_one_error(text: str, beginning: str) -> None:
    try:
        specs = parse_devices(beginning + text)
    except SpecError:
        return
    assert specs
    assert all(spec.kind in DEVICE_KINDS and spec.address for spec in specs)


def test_open_distinguishes_devices_from_recordings() -> None:
    assert drivers.open("ld06:/dev/nothing").name == "ld06:/dev/nothing"
    assert len(drivers.open("ld06:/dev/nothing")) == 0
    assert not is_device_spec("drive.mcap")
    assert not is_device_spec("ld06.mcap")
    with pytest.raises(DriverError, match="no option"):
        drivers.open("ld06:/dev/nothing?x=1")
