"""`report.html`: its content, its independence of other files, and its behaviour in a real browser."""

import html
import json
import re
import shutil
import subprocess
from base64 import b64encode
from collections.abc import Iterator
from dataclasses import fields, replace
from hashlib import sha256
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slam.config import Config
from slam.errors import MapError
from slam.events import Finished
from slam.io.json_files import write_json
from slam.io.run_results import RunResults, read_run_results, write_results
from slam.measuring.map_measurements import measure_walls
from slam.measuring.wall_map import WallMap
from slam.visualisation.report_page import write_page
from slam.visualisation.report_page.findings import findings, reason_without_walls

DECISION = {
    "candidate": 5,
    "stamp": 16.0,
    "keyframe": 4,
    "old": 1,
    "status": "accepted",
    "reason": "all checks passed",
    "matches": 6,
    "merged": 3,
    "motion": [0.1, 0.0, 0.0],
    "overlap_ratio": 0.81,
    "runner_up": 0.4,
    "sigma": 0.02,
    "contradicted": 0.0,
    "shift": 0.13,
}
REJECTED = (("rejected", 7), ("rejected", 6))
SUMMARY: dict[str, Any] = {
    "recording": "room.mcap",
    "scans": 100,
    "duration": 20.0,
    "keyframes": 6,
    "walls": 4,
    "corners": 2,
    "path_length": 4.4,
    "slam_seconds": 1.0,
    "real_time_factor": 20.0,
    "peak_memory_mib": 300.0,
    "truth": {"ate_rmse": 0.0213, "ate_median": 0.02, "ate_max": 0.31, "heading_rmse": 0.42},
    "warnings": [],
    "skipped": {"messages": 0, "reasons": {}, "first": None},
    "slam": {
        "loops": {"proposed": 3, "accepted": 1, "rejected": 2, "retracted": 0},
        "loop_decisions": [
            DECISION,
            DECISION | {"candidate": 6, "status": "rejected", "reason": "<b>no</b>", "margin": 0.3},
            DECISION | {"candidate": 7, "status": "rejected", "reason": "3 looks agree", "margin": 0.75},
        ],
        "returns": {"count": 3, "looks": 20, "position_rms": 0.012, "position_max": 0.04},
        "timings": {"keyframe_median_ms": 1.5, "keyframe_p99_ms": 9.0, "keyframe_max_ms": 30.0, "graph_mean_ms": 0.7},
        "health": {"overlap_ratio_median": 0.95},
        "states": [],
    },
}


def make(folder: Path, finished: Finished, summary: dict[str, Any] = SUMMARY) -> RunResults:
    """Write and read a session whose path becomes ever less certain."""
    sigma = np.linspace(0.01, 0.15, len(finished.keyframes))
    covariance = np.eye(3) * np.square(sigma)[:, None, None]
    folder.mkdir(exist_ok=True)
    write_results(folder, replace(finished, keyframe_covariance=covariance), Config(), summary)
    return read_run_results(folder)


def page(folder: Path, finished: Finished, summary: dict[str, Any] = SUMMARY) -> str:
    session = make(folder, finished, summary)
    write_page(folder / "report.html", session)
    return (folder / "report.html").read_text(encoding="utf-8")


def words(text: str) -> str:
    """Return the visible text, without markup and scripts."""
    text = re.sub(r"<(style|script|svg).*?</\1>", " ", text, flags=re.DOTALL)
    return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", text)).split())


def test_the_page_shows_the_run(tmp_path: Path, finished: Finished) -> None:
    text = page(tmp_path / "out", finished)
    visible = words(text)
    for expected in (
        "room.mcap",
        "4.40 m",
        "No problems found.",
        "The path is within 2.1 cm of the true one (RMS).",
        "Returned 3 times to a known place; the map was correct there to 1.2 cm (RMS of 20 comparisons),",
        "1 loop closed, which moved the robot by up to 0.13 m; 2 rejected as unsafe.",
        "all checks passed 81 % 6 40 % 2.0 cm 0 % 0.13 m",
        "position, RMS 2.1 cm",
        "heading, RMS 0.42°",
        "20 times as fast as the recording",
        "graph 0.70 ms",
        "sigma_range = 0.01",
        "under 2 cm under 5 cm under 10 cm under 20 cm",
    ):
        assert expected in visible, expected
    assert set(re.findall(r'<polyline class="(\w+)"', text)) == {"p0", "p1", "p2", "p3"}
    assert 'class="accepted" data-loop="5"' in text
    order = [text.index(f'<tr class="{status}" data-loop="{k}"') for status, k in (("accepted", 5), *REJECTED)]
    assert order == sorted(order)  # the rejected loop that came nearest to being closed is the first of them


def test_the_page_references_no_other_file(tmp_path: Path, finished: Finished) -> None:
    class Links(HTMLParser):
        found: list[str] = []  # noqa: RUF012

        def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
            self.found += [value or "" for name, value in attributes if name in ("src", "href", "xlink:href", "data")]

    text = page(tmp_path / "out", finished)
    links = Links()
    links.feed(text)
    assert set(links.found) <= {"data:,", "#drawing"}
    assert not re.search(r"https?:|//[a-z]|@import|url\(", text.replace("data:,", ""))


def test_the_page_names_the_places_where_the_map_is_poorly_known(tmp_path: Path, finished: Finished) -> None:
    text = page(tmp_path / "out", finished)
    assert "100 % of the length of the walls is known to 2 cm, 100 % to 5 cm." in words(text)
    assert "3 m of the path are known to 15 cm only" in words(text)
    assert len(re.findall(r'<circle class="stretch"', text)) == 1
    known = replace(finished, keyframe_covariance=np.tile(1e-6 * np.eye(3), (len(finished.keyframes), 1, 1)))
    write_results(tmp_path / "out", known, Config(), SUMMARY)
    write_page(tmp_path / "known.html", read_run_results(tmp_path / "out"))
    assert "No place would need another drive." in words((tmp_path / "known.html").read_text(encoding="utf-8"))
    (tmp_path / "out" / "keyframes.csv").unlink()
    write_page(tmp_path / "without.html", read_run_results(tmp_path / "out"))
    without = (tmp_path / "without.html").read_text(encoding="utf-8")
    assert "poorly known" not in without
    assert 'class="layer"' not in without


def test_names_and_reasons_are_escaped(tmp_path: Path, finished: Finished) -> None:
    nasty = '<script>alert("1")</script>&$title.mcap'
    summary = SUMMARY | {"recording": nasty, "warnings": [f"{nasty} (at 3.00 s)"]}
    text = page(tmp_path / "out", finished, summary)
    assert "<script>alert" not in text
    assert "<b>no</b>" not in text
    assert nasty in html.unescape(text)
    assert words(text).count(nasty) == 4  # title, heading, warning, details


def test_a_session_of_an_older_version_has_a_page(tmp_path: Path, finished: Finished) -> None:
    old = {name: value for name, value in SUMMARY.items() if name not in ("truth", "skipped", "warnings", "slam")}
    session = make(tmp_path / "out", finished, old)
    (tmp_path / "out" / "keyframes.csv").unlink()
    session = read_run_results(tmp_path / "out")
    write_page(tmp_path / "a.html", session)
    text = words((tmp_path / "a.html").read_text(encoding="utf-8"))
    assert "ground truth" not in text
    assert "No loop was closed or rejected." in text


def test_a_map_without_walls_has_a_page(tmp_path: Path, finished: Finished) -> None:
    nothing = {f.name: getattr(finished.walls, f.name)[:0] for f in fields(finished.walls)}
    corners = {f.name: getattr(finished.corners, f.name)[:0] for f in fields(finished.corners)}
    empty = replace(
        finished,
        walls=replace(finished.walls, **nothing),
        corners=replace(finished.corners, **corners),
        stamps=finished.stamps[:1],
        poses=finished.poses[:1],
        keyframe_stamps=finished.keyframe_stamps[:1],
        keyframes=finished.keyframes[:1],
    )
    without = SUMMARY | {"slam": {}}
    assert "<svg" in page(tmp_path / "out", empty, without)


def test_findings_describe_problems_grave_ones_first(tmp_path: Path, finished: Finished) -> None:
    slam = {
        "loop_decisions": [{"status": "retracted", "stamp": 30.0}, {"status": "retracted", "stamp": 40.0}],
        "health": {"overlap_ratio_median": 0.6, "no_features": 1, "empty_scans": 4},
        "odometry": {"random": {"along": 1.58, "across": 0.1, "heading_per_metre": 0.02, "heading_per_radian": 0.1}},
        "states": [
            {"stamp": 2.0, "state": "LOST", "direction": None},
            {"stamp": 5.0, "state": "OK", "direction": None},
            {"stamp": 12.0, "state": "DEGENERATE", "direction": 1.0},
        ],
    }
    summary = SUMMARY | {
        "slam": slam,
        "real_time_factor": 0.5,
        "warnings": ["no odometry for a while", *(f"the scan fits nowhere near (at {s:.2f} s)" for s in range(70, 76))],
        "skipped": {"messages": 3, "reasons": {"the scan's stamp is before the last": 3}, "first": "x"},
        "doubts": ["odometry stands still"],
    }
    found = findings(summary, make(tmp_path / "out", finished, summary).trajectory)
    texts = [finding.text for finding in found]
    assert texts == [
        "For 3 s in total, the robot was lost, at 0:02.",
        "The overlap ratio of scans with the map is only 60 %.",
        "Odometry deviates by 158 % of the travelled distance.",
        "Odometry stands still.",
        "For 8 s in total, one direction was degenerate, at 0:12.",
        "No odometry for a while.",
        "The scan fits nowhere near, 6 times, first at 1:10, 1:11, 1:12, 1:13.",
        "2 loop closures had to be retracted, at 0:30, 0:40.",
        "1 scan had no features.",
        "4 scans had no return at all.",
        "3 messages of the recording could not be used.",
        "SLAM took 2.0 times as long as the recording.",
    ]
    assert [finding.grave for finding in found] == [True] * 4 + [False] * 8
    assert [finding.stamp for finding in found] == [2.0, *3 * [None], 12.0, None, 70.0, 30.0, *4 * [None]]
    assert findings(SUMMARY, make(tmp_path / "out", finished).trajectory) == []


def test_a_mount_that_the_drive_contradicts_is_a_finding(tmp_path: Path, finished: Finished) -> None:
    trajectory = make(tmp_path / "out", finished).trajectory
    errors = {name: {"value": 0.0, "sigma": 0.004} for name in ("length", "turning", "veer", "x", "y", "heading")}
    assert findings(SUMMARY | {"slam": {"odometry": {"systematic": errors}}}, trajectory) == []
    errors |= {"x": {"value": -0.0896, "sigma": 0.0025}, "heading": {"value": 0.0175, "sigma": 0.0023}}
    (finding,) = findings(SUMMARY | {"slam": {"odometry": {"systematic": errors}}}, trajectory)
    assert finding.text == (
        "The lidar is not where `lidar.mount` says, relative to the axle: 9.0 ± 0.2 cm ahead, 0.0 ± 0.4 cm to the "
        "left, 1.0 ± 0.1 degrees to the right."
    )
    assert not finding.grave


def test_warnings_of_one_second_have_one_time(tmp_path: Path, finished: Finished) -> None:
    warnings = [f"odometry slipped (at {70 + k / 10} s)" for k in range(6)]
    trajectory = make(tmp_path / "out", finished).trajectory
    (finding,) = findings(SUMMARY | {"warnings": warnings}, trajectory)
    assert finding.text == "Odometry slipped, 6 times, at 1:10."


def test_the_page_states_why_no_loop_was_closed_and_how_the_recording_was_read(
    tmp_path: Path, finished: Finished
) -> None:
    slam = {"loops": {}, "loop_decisions": [], "returns": SUMMARY["slam"]["returns"]}
    read = {"interpretations": ["beams in the opposite order", "lidar 0.2 s late"]}
    text = words(page(tmp_path / "a", finished, SUMMARY | read | {"slam": slam}))
    assert "No loop had to be closed: the map was correct wherever the robot returned to a known place." in text
    assert "read as beams in the opposite order; lidar 0.2 s late" in text
    text = words(page(tmp_path / "b", finished, SUMMARY | {"slam": slam | {"returns": {"count": 0, "looks": 0}}}))
    assert "No loop was closed or rejected, as no return to a known place was found." in text


def test_suspects_are_findings_and_only_those_of_the_path_are_grave(tmp_path: Path, finished: Finished) -> None:
    rows = [
        {"check": check, "stamp": 5.0 + k, "first": 5.0, "last": 5.0, "position": [0.0, 0.0], "weight": 2.0,
         "text": f"the {check} is wrong, as the scans around 72.5 s saw"}
        for k, check in enumerate(["map", "placement", "odometry"] + 9 * ["odometry"])
    ]  # fmt: skip
    summary = SUMMARY | {"slam": SUMMARY["slam"] | {"suspects": rows}}
    found = findings(summary, make(tmp_path / "out", finished, summary).trajectory)
    assert [finding.grave for finding in found] == [True, True] + 9 * [False]
    assert found[0].text == "Suspect at 0:05: the map is wrong, as the scans around 1:12 saw."
    assert found[-1].text == "2 more suspects in summary.json."


def test_long_lists_of_doubts_are_folded_and_a_doubtful_map_is_not_praised(tmp_path: Path, finished: Finished) -> None:
    row = {"check": "map", "stamp": 5.0, "first": 5.0, "last": 5.0, "position": [0.0, 0.0], "weight": 2.0, "text": "?"}
    slam = SUMMARY["slam"] | {
        "health": {"overlap_ratio_median": 0.95, "lost": 0, "failed": 0},
        "returns": {},
        "loops": {},
    }
    summary = {key: value for key, value in SUMMARY.items() if key != "truth"}
    good = page(tmp_path / "good", finished, summary | {"slam": slam})
    assert "Every scan was placed in the map; the robot was never lost" in good
    assert "95 % of the walls" in good
    gaps = slam | {"health": slam["health"] | {"no_features": 3}}
    with_gaps = page(tmp_path / "gaps", finished, summary | {"slam": gaps})
    assert "Every scan that showed features was placed in the map" in with_gaps
    bad = page(tmp_path / "bad", finished, summary | {"slam": slam | {"suspects": 7 * [row]}})
    assert "What went well" not in bad
    folded = re.search(r"<details><summary>3 more</summary><ul>(.*?)</ul></details>", bad, re.DOTALL)
    assert folded.group(1).count("<li ") == 3
    assert bad.count("Suspect at") == 7


@pytest.mark.parametrize(
    ("health", "reason"),
    [
        ({"empty_scans": 90}, "90 of 100 scans had no return"),
        ({"no_features": 80}, "in 80 of 100 scans nothing was straight"),
        ({}, "no straight line was seen from two places"),
    ],
)
def test_a_map_without_walls_is_explained(health: dict[str, int], reason: str) -> None:
    summary = {"walls": 0, "scans": 100, "slam": {"health": health}}
    assert reason in reason_without_walls(summary)
    assert reason_without_walls(summary | {"walls": 1}) == ""


# The command


def test_the_report_command_writes_the_page_of_an_older_session(wclm: Any, fake_slam: type) -> None:
    assert wclm("run", "sim:room?duration=3", "--out", "out", "--no-review").exit_code == 0
    written = Path("out/report.html").read_text()
    Path("out/report.html").unlink()
    result = wclm("report", "out")
    assert (result.exit_code, result.stdout) == (0, "out/report.html\n")
    assert Path("out/report.html").read_text() == written
    wclm.refuses("report", "out", because=["out/report.html: exists already", "--overwrite"])
    assert wclm("report", "out", "--overwrite").exit_code == 0
    wclm.refuses("report", "out", "--measure", "--overwrite", because=["out: has no keyframe, so it has no walls"])
    assert wclm("report", "out", "--out", "a.html").exit_code == 0
    assert Path("a.html").read_text() == written
    write_json(Path("out/summary.json"), {"recording": "a"})
    wclm.refuses("report", "out", "--overwrite", because=["out: not the summary of a run: 'path_length'"])
    assert Path("out/report.html").read_text() == written


def test_results_are_kept_if_the_page_fails(
    wclm: Any, fake_slam: type, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object) -> None:
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("slam.visualisation.report_page.write_page", fails)
    result = wclm("run", "sim:room?duration=3", "--out", "out", "--no-review")
    assert isinstance(result.exception, ZeroDivisionError)
    present = {file.name for file in (tmp_path / "out").iterdir()}
    assert {"trajectory.tum", "map.json", "summary.json"} <= present
    assert not any("report" in name for name in present)


# A real browser

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--enable-logging=stderr",
    "--virtual-time-budget=3000",
    "--dump-dom",
)
in_a_browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed (apt-get install chromium)")


def render(file: Path, size: str = "1280,900") -> tuple[str, list[str]]:
    """Return the document after its scripts have run, and the lines of the browser's console."""
    assert CHROMIUM is not None
    profile = file.parent / f"profile-{file.stem}"
    command = [CHROMIUM, *FLAGS, f"--window-size={size}", f"--user-data-dir={profile}", file.as_uri()]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    return answer.stdout, [line for line in answer.stderr.splitlines() if "CONSOLE" in line]


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


def hostile(value: Any) -> Iterator[Any]:
    """Yield copies of nested data with one leaf replaced by markup, each leaf once."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from ({**value, key: bad} for bad in hostile(item))
            yield {(MARKUP if name == key else name): kept for name, kept in value.items()}
    elif isinstance(value, list):
        for k, item in enumerate(value):
            yield from ([*value[:k], bad, *value[k + 1 :]] for bad in hostile(item))
    yield MARKUP
    yield 0
    yield None


MARKUP = '"><script>alert(1)</script>'


def test_markup_in_a_foreign_summary_is_never_executed(tmp_path: Path, finished: Finished) -> None:
    session = make(tmp_path / "run", finished)
    texts = {"warnings": ["a"], "doubts": ["b"], "interpretations": ["d"]}
    whole = SUMMARY | texts | {"versions": {"numpy": "2"}, "recording_path": "c"}
    written = 0
    for summary in hostile(whole):
        if not isinstance(summary, dict):
            continue
        try:
            write_page(tmp_path / "report.html", replace(session, summary=summary))
        except MapError:
            continue
        written += 1
        assert "<script>alert" not in (tmp_path / "report.html").read_text(encoding="utf-8"), summary
    assert written > 50


def test_only_the_script_of_the_page_may_run(tmp_path: Path, finished: Finished) -> None:
    text = page(tmp_path, finished)
    (script,) = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    digest = b64encode(sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in text


def test_a_recording_without_duration_has_a_page(tmp_path: Path, finished: Finished) -> None:
    assert "0.0 s" in page(tmp_path, finished, SUMMARY | {"duration": 0.0, "real_time_factor": 0.0})


def test_a_summary_that_is_no_text_is_refused(tmp_path: Path, finished: Finished) -> None:
    make(tmp_path, finished)
    (tmp_path / "summary.json").write_text(json.dumps(SUMMARY | {"recording": "\ud800"}))
    with pytest.raises(MapError, match="not the summary of a run: 'utf-8' codec can't encode"):
        write_page(tmp_path / "report.html", read_run_results(tmp_path))


@pytest.mark.parametrize(
    ("name", "value"),
    [("slam", 5), ("recordings", {"a": 1}), ("recordings", [5]), ("recordings", [{"shift": "x"}]), ("warnings", "x")],
)
def test_a_summary_with_an_entry_of_another_type_is_refused(
    tmp_path: Path, finished: Finished, name: str, value: object
) -> None:
    make(tmp_path, finished)
    write_json(tmp_path / "summary.json", SUMMARY | {name: value})
    with pytest.raises(MapError, match=r"summary\.json: (recordings or )?\w+ (is not a|has an entry|is invalid)"):
        read_run_results(tmp_path)
