"""Files of pins."""

from pathlib import Path

import pytest

from slam.errors import MapError
from slam.io.pins_csv import read_pins

HEADER = "kind,id,x,y,sigma,heading,sigma_heading\n"


def test_poses_and_walls_are_read(tmp_path: Path) -> None:
    file = tmp_path / "pins.csv"
    file.write_text("kind, id, x, y, xx, xy, yy\npose,12.5,1,2,4e-4,1e-4,9e-4\nwall,7,3,4,1e-4,0,1e-4\n")
    pose, wall = read_pins(file).pins
    assert (pose.kind, pose.id, pose.x, pose.y) == ("pose", 12.5, 1.0, 2.0)
    assert (pose.xx, pose.xy, pose.yy, pose.heading) == (4e-4, 1e-4, 9e-4, None)
    assert wall.name == "wall 7"
    assert pose.name == "pose at 12.5 s"
    file.write_text(HEADER + "pose,1546300800.25,1,2,0.01,-0.5,0.002\n")
    (pin,) = read_pins(file).pins
    assert (pin.xx, pin.xy, pin.yy) == pytest.approx((1e-4, 0.0, 1e-4))
    assert (pin.heading, pin.sigma_heading) == (-0.5, 0.002)
    assert pin.name == "pose at 1546300800.25 s"  # stamps of recordings count from 1970


@pytest.mark.parametrize(
    ("text", "because"),
    [
        ("", "is empty"),
        ("kind,id,x,y\n", "nor the columns xx"),
        ("kind,id,x,y,sigma,colour\n", "unknown column colour"),
        ("kind,id,x,y,sigma,co\x1dlour\n", "unknown column co\N{REPLACEMENT CHARACTER}lour"),
        (HEADER, "has no pins"),
        (HEADER + "pose,1,2,3,0.01\n", "pins.csv:2: has another number of columns"),
        (HEADER + "\npose,1,2,x,0.01,,\n", "pins.csv:3: y is no number: x"),
        (HEADER + "pose,1,2,,0.01,,\n", "pins.csv:2: y is missing"),
        (HEADER + "door,1,2,3,0.01,,\n", "pins.csv:2: kind"),
        (HEADER + "wall,1.5,2,3,0.01,,\n", "no identity of a wall"),
        (HEADER + "pose,1,2e7,3,0.01,,\n", "subtract a common offset"),
        (HEADER + "pose,1,2,3,,,\n", "either sigma or"),
        (HEADER + "pose,1,2,3,0,,\n", "no covariance"),
        (HEADER + "pose,1,2,3,1e200,,\n", "sigma is not between"),
        (HEADER + "pose,1,2,3,-0.01,,\n", "sigma is not between"),
        (HEADER + f"pose,1,2,3,{'x' * 5000},,\n", "sigma is no number: xxx"),
        ("kind,id,x,y,xx,xy,yy\npose,1,2,3,1e-4,1e200,1e-4\n", "xy: input should be less"),
        (HEADER + "pose,1,2,3,0.01,1,\n", "must be stated together"),
        ("kind,id,x,y,xx,xy,yy\npose,1,2,3,1e-4,2e-4,1e-4\n", "no covariance"),
    ],
)
def test_a_wrong_file_is_refused_with_the_place(tmp_path: Path, text: str, because: str) -> None:
    file = tmp_path / "pins.csv"
    file.write_text(text)
    with pytest.raises(MapError, match=r"pins\.csv") as error:
        read_pins(file)
    assert because in str(error.value)
    assert "\n" not in str(error.value)


def test_a_file_that_is_missing_or_binary_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"pins\.csv"):
        read_pins(tmp_path / "pins.csv")
    (tmp_path / "pins.csv").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(MapError, match="is not a CSV file"):
        read_pins(tmp_path / "pins.csv")
