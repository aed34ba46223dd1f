"""The report page in a real browser: zooming, choosing walls, and no messages on its console."""

import html
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slam.events import Finished
from slam.measuring.map_measurements import measure_walls
from slam.measuring.wall_map import WallMap
from slam.visualisation.report_page import write_page

from ..chromium import in_a_browser, render
from .report_pages import SUMMARY, make, page


@in_a_browser
def test_a_browser_shows_the_page_without_console_messages(tmp_path: Path, finished: Finished) -> None:
    text = page(tmp_path, finished)
    document, console = render(tmp_path / "report.html", "390,800")
    assert console == []
    assert re.search(r'<div class="scale"><i style="width: [\d.]+px;"></i><span>[125]0* (m|cm)</span>', document)
    (tmp_path / "broken.html").write_text(text.replace('"use strict";', "nothing.there();"), encoding="utf-8")
    reported = render(tmp_path / "broken.html")[1][0]
    assert "Content Security Policy" in reported  # only the script of the page may run


PROBE = """
<script>
const told = {};
const svg = document.querySelector("#map svg");
const box = () => svg.getAttribute("viewBox").split(" ").map(Number);
const pointer = (name, x, y, id) => svg.dispatchEvent(new PointerEvent(name,
  {clientX: x, clientY: y, pointerId: id, pointerType: "touch", bubbles: true}));
svg.setPointerCapture = () => {};
svg.scrollIntoView({block: "center"});
told.all = box();
const drawn = () => [...svg.querySelectorAll(".path polyline")].map((line) => line.getAttribute("points")).join(" ");
told.whole = drawn().length;
const wall = svg.querySelector(".walls path").getBoundingClientRect();
svg.dispatchEvent(new MouseEvent("click", {clientX: wall.left + wall.width / 2, clientY: wall.top + 7, bubbles: true}));
told.about = document.getElementById("about").textContent;
document.querySelector('[data-zoom="0.6"]').click();
told.larger = box();
pointer("pointerdown", 300, 200, 1); pointer("pointermove", 340, 230, 1); pointer("pointerup", 340, 230, 1);
told.dragged = box();
pointer("pointerdown", 300, 200, 1); pointer("pointerdown", 400, 200, 2);
pointer("pointermove", 500, 200, 2); pointer("pointerup", 500, 200, 2); pointer("pointerup", 300, 200, 1);
told.pinched = box();
for (let k = 0; k < 30; k++) document.querySelector('[data-zoom="1.667"]').click();
told.least = box();
svg.dispatchEvent(new WheelEvent("wheel", {deltaY: -100, clientX: 300, clientY: 200, cancelable: true}));
told.scrolled = box();
svg.dispatchEvent(new WheelEvent("wheel", {deltaY: -100, ctrlKey: true, clientX: 300, clientY: 200}));
told.wheel = box();
document.querySelector('tr[data-loop="5"]').click();
told.loop = document.getElementById("about").textContent;
document.querySelector('[data-zoom="0"]').click();
told.again = box();
const slider = document.querySelector(".time input");
slider.value = slider.max / 2;
slider.dispatchEvent(new Event("input"));
told.half = drawn().length;
told.robot = svg.querySelector(".robot").getAttribute("visibility");
told.hidden = svg.querySelector('.loops [data-loop="5"]').style.visibility;
const row = document.querySelector('tr[data-loop="7"]');
row.focus();
row.dispatchEvent(new KeyboardEvent("keydown", {key: "Enter", bubbles: true}));
told.key = document.getElementById("about").textContent;
slider.value = slider.max;
slider.dispatchEvent(new Event("input"));
told.end = drawn().length;
const zoom = document.querySelector("#map [data-zoom]").getBoundingClientRect();
told.covered = zoom.top < svg.getBoundingClientRect().bottom;
const place = document.querySelector("button.place");
place.click();
told.place = [slider.value, ...box()];
const weak = () => getComputedStyle(svg.querySelector(".weak")).display;
told.layers = [weak()];
document.querySelector(".layer input").click();
told.layers.push(weak());
document.querySelector(".layer input").click();
told.layers.push(weak());
document.querySelector("#confidence button.place").click();
told.layers.push(weak());
told.checked = document.querySelector(".layer input").checked;
told.wide = document.documentElement.scrollWidth <= window.innerWidth;
document.documentElement.dataset.told = JSON.stringify(told);
</script>
"""


@in_a_browser
@pytest.mark.parametrize("size", ["1280,900", "500,800"])
def test_the_map_can_be_zoomed_dragged_and_queried(tmp_path: Path, finished: Finished, size: str) -> None:
    text = page(tmp_path, finished, SUMMARY | {"warnings": ["the scan fits nowhere (at 5.00 s)"]})
    text = re.sub("'sha256-[^']*'", "'unsafe-inline'", text)  # admits the script of the test
    (tmp_path / "probe.html").write_text(text.replace("</body>", PROBE + "</body>"), encoding="utf-8")
    document, console = render(tmp_path / "probe.html", size)
    assert console == []
    told = json.loads(html.unescape(re.search(r'data-told="(.*?)"', document).group(1)))
    assert told["about"].startswith("wall 0: 6.00 m, observed in 5 keyframes")
    assert told["larger"][2] == pytest.approx(0.6 * told["all"][2], rel=1e-3)
    middle = [told["all"][k] + told["all"][k + 2] / 2 for k in (0, 1)]
    assert [told["larger"][k] + told["larger"][k + 2] / 2 for k in (0, 1)] == pytest.approx(middle, abs=1e-3)
    assert told["dragged"][0] < told["larger"][0]  # dragging to the right shows more of the left
    assert told["dragged"][2] == told["larger"][2]
    assert told["pinched"][2] < 0.7 * told["dragged"][2]
    assert told["least"] == pytest.approx(told["all"], abs=1e-3)
    assert told["scrolled"] == told["least"]  # the page scrolls
    assert told["wheel"][2] < told["least"][2]
    assert told["loop"] == "loop 5, accepted: keyframe 4 at the place of 1"
    assert told["again"] == told["all"]
    assert told["half"] < 0.8 * told["whole"]
    assert (told["robot"], told["hidden"], told["end"]) == ("visible", "hidden", told["whole"])
    assert told["key"].startswith("loop 7, rejected")
    assert told["place"][0] == "5"
    assert told["place"][3] == pytest.approx(0.25 * told["all"][2], rel=1e-3)
    assert told["layers"] == ["none", "inline", "none", "inline"]
    assert told["checked"]
    assert told["wide"]  # no horizontal overflow
    assert told["covered"] == (size != "500,800")  # on a phone the buttons are below the map


CHOOSE = """
<script>
const told = [];
const svg = document.querySelector("#map svg");
svg.scrollIntoView({block: "center"});
for (const wall of [0, 3, 1]) {
  const box = svg.querySelector(`.walls [data-wall="${wall}"]`).getBoundingClientRect();
  const x = box.left + box.width / 2, y = box.top + box.height / 2;
  svg.dispatchEvent(new MouseEvent("click", {clientX: x, clientY: y, bubbles: true}));
  told.push(document.getElementById("about").textContent);
}
document.documentElement.dataset.told = JSON.stringify(told);
</script>
"""


@in_a_browser
def test_two_chosen_walls_are_measured_as_by_the_command(tmp_path: Path, finished: Finished) -> None:
    random = np.random.default_rng(3)
    root = random.normal(size=(8, 8)) * np.tile([2e-3, 5e-4], 4)[:, None]
    frames = finished.walls.frame + random.normal(size=(4, 3)) * [0.01, 0.01, 0.02]  # not quite parallel
    walls = replace(finished.walls, frame=frames)
    wall_map = WallMap(walls, finished.corners, root @ root.T, finished.poses[:, :2])
    write_page(tmp_path / "a.html", make(tmp_path / "out", replace(finished, walls=walls)), wall_map)
    text = re.sub("'sha256-[^']*'", "'unsafe-inline'", (tmp_path / "a.html").read_text(encoding="utf-8"))
    (tmp_path / "probe.html").write_text(text.replace("</body>", CHOOSE + "</body>"), encoding="utf-8")
    document, console = render(tmp_path / "probe.html")
    assert console == []
    one, parallel, across = json.loads(html.unescape(re.search(r'data-told="(.*?)"', document).group(1)))
    assert one.startswith("wall 0: ")
    distance, angle = measure_walls(wall_map, [0, 3])[-2:]
    turn, turn_sigma = np.degrees([angle.value, angle.sigma])
    assert parallel == (
        f"walls 0 and 3: distance {distance.value:.4f} m, standard deviation {1e3 * distance.sigma:.1f} mm; "
        f"angle {turn:.2f}°, standard deviation {turn_sigma:.2f}°"
    )
    angle = measure_walls(wall_map, [3, 1])[-1]
    turn, turn_sigma = np.degrees([angle.value, angle.sigma])
    assert across == f"walls 3 and 1: angle {turn:.2f}°, standard deviation {turn_sigma:.2f}°"
