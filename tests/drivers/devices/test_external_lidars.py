"""A lidar whose driver is another package is named and read as those of this one."""

import os
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.devices.device_spec import SpecError, is_device_spec, parse_device
from drivers.devices.external_lidars import GROUP, external_kinds
from drivers.devices.registry import make_device
from drivers.errors import DriverError

EXAMPLE = Path(__file__).parents[3] / "examples" / "own_lidar"
DRIVER = """
from drivers.devices.device_spec import Option
from drivers.devices.lidar import LidarDevice

class Lidar(LidarDevice):
    bauds = (9600,)
    own_options = {"filter": Option(float, "metres")}
    identify = halt = start_stream = lambda self, *_: None
"""


def install(folder: Path, package: str, kind: str, value: str) -> None:
    """Write what an installer writes for a package with an entry point."""
    metadata = folder / f"{package}-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(f"[{GROUP}]\n{kind} = {value}\n")


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Folder of installed packages, with a module of a driver."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "external_driver.py").write_text(DRIVER)
    yield tmp_path
    sys.modules.pop("external_driver", None)


def test_a_lidar_of_another_package_is_a_kind_of_device(site: Path) -> None:
    install(site, "one", "turner", "external_driver:Lidar")
    assert external_kinds() == ["turner"]
    assert is_device_spec("turner:/dev/ttyUSB0")
    spec = parse_device("turner:/dev/ttyUSB0?filter=0.5&range_max=8&baud=4800")
    assert spec.is_lidar
    assert dict(spec.options) == {"filter": 0.5, "range_max": 8.0, "baud": 4800}
    device = make_device(spec)
    assert type(device).__name__ == "Lidar"
    assert device.bauds == (4800,)
    with pytest.raises(SpecError, match=r"turner has no option 'mode'; it has baud, tape, .*, filter"):
        parse_device("turner:/dev/ttyUSB0?mode=1")
    with pytest.raises(SpecError, match=r"not a device; there are rplidar:PORT, .*, turner:PORT"):
        parse_device("turned:/dev/ttyUSB0")


def test_a_driver_of_this_package_is_not_replaced(site: Path) -> None:
    install(site, "one", "ld06", "external_driver:Lidar")
    assert type(make_device(parse_device("ld06:/dev/ttyUSB0"))).__name__ == "Ld06Device"


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        ("external_driver:DRIVER", "external_driver:DRIVER of one: cannot be loaded: AttributeError: "),
        ("no_such_module:Lidar", "no_such_module:Lidar of one: cannot be loaded: ModuleNotFoundError: "),
        (
            "external_driver:Option",
            "external_driver:Option of one: is no subclass of drivers.devices.lidar.Lidar",
        ),
    ],
)
def test_a_driver_that_cannot_be_used_is_named(site: Path, value: str, reason: str) -> None:
    install(site, "one", "turner", value)
    with pytest.raises(DriverError, match=reason):
        parse_device("turner:/dev/ttyUSB0")


def test_two_packages_with_one_kind_are_named(site: Path) -> None:
    install(site, "one", "turner", "external_driver:Lidar")
    install(site, "two", "turner", "other_driver:Lidar")
    with pytest.raises(DriverError, match="external_driver:Lidar of one, other_driver:Lidar of two"):
        parse_device("turner:/dev/ttyUSB0")


@pytest.mark.slow
def test_the_example_of_a_package_passes_its_own_tests(tmp_path: Path) -> None:
    """They read the emulated lidar in a process of its own, as `wclm live` does."""
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"]
    ((kind, value),) = project["entry-points"][GROUP].items()
    install(tmp_path, project["name"].replace("-", "_"), kind, value)
    paths = [str(tmp_path), str(EXAMPLE), str(EXAMPLE.parents[1])]
    ended = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(EXAMPLE)],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths), "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        cwd=tmp_path,
        timeout=60,
    )
    assert ended.returncode == 0, ended.stdout
    assert "2 passed" in ended.stdout
