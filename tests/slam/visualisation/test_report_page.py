"""`report.html`: its content, its independence of other files, and foreign content in it."""

import html
import json
import re
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
from slam.io.run_results import read_run_results, write_results
from slam.mapping.map_features import Keyframes
from slam.visualisation.report_page import write_page
from slam.visualisation.report_page.findings import findings, reason_without_walls

from .report_pages import REJECTED, SUMMARY, make, page, words


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
    covariance = np.tile(1e-6 * np.eye(3), (len(finished.keyframes), 1, 1))
    known = replace(finished, keyframes=replace(finished.keyframes, covariance=covariance))
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
        keyframes=Keyframes.without_covariance(finished.stamps[:1], finished.poses[:1]),
    )
    without = SUMMARY | {"slam": {}}
    assert "<svg" in page(tmp_path / "out", empty, without)


def test_findings_describe_problems_grave_ones_first(tmp_path: Path, finished: Finished) -> None:
    slam = {
        "loop_decisions": [{"status": "retracted", "stamp": 30.0}, {"status": "retracted", "stamp": 40.0}],
        "health": {"overlap_ratio_median": 0.6, "no_features": 1, "empty_scans": 4},
        "odometry": {
            "systematic": {"length": {"value": 1.01, "sigma": 0.01}},
            "random": {"along": 1.58, "across": 0.1, "heading_per_metre": 0.02, "heading_per_radian": 0.1},
        },
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
        "Only 60 % of the walls that a scan shows are on walls of the map: the path is wrong, things move, or the "
        "lidar sees the robot itself, the floor or through windows.",
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


@pytest.mark.parametrize(
    ("factor", "sigma", "text"),
    [
        (0.5, 0.02, "Odometry measures 2.00 times the turns that the scans show."),
        (1.6, 0.02, "Odometry measures 0.62 times the turns that the scans show."),
        (1.6, 0.2, None),
        (1.1, 0.01, None),
        (0.9, 0.01, None),
    ],
)
def test_a_wrong_scale_of_odometry_is_reported(
    factor: float, sigma: float, text: str | None, tmp_path: Path, finished: Finished
) -> None:
    trajectory = make(tmp_path / "out", finished).trajectory
    errors = {"length": {"value": 1.01, "sigma": 0.01}, "turning": {"value": factor, "sigma": sigma}}
    found = findings(SUMMARY | {"slam": {"odometry": {"systematic": errors}}}, trajectory)
    assert [finding.text for finding in found] == ([] if text is None else [text])


def test_errors_of_predictions_are_no_finding_about_odometry(tmp_path: Path, finished: Finished) -> None:
    trajectory = make(tmp_path / "out", finished).trajectory
    assert findings(SUMMARY | {"slam": {"odometry": {"random": {"along": 0.39}}}}, trajectory) == []


def test_a_mount_that_the_drive_contradicts_is_a_finding(tmp_path: Path, finished: Finished) -> None:
    trajectory = make(tmp_path / "out", finished).trajectory
    errors = {name: {"value": 0.0, "sigma": 0.004} for name in ("veer", "x", "y", "heading")}
    assert findings(SUMMARY | {"slam": {"odometry": {"systematic": errors}}}, trajectory) == []
    errors |= {"x": {"value": -0.0896, "sigma": 0.0025}, "heading": {"value": 0.0175, "sigma": 0.0023}}
    (finding,) = findings(SUMMARY | {"slam": {"odometry": {"systematic": errors}}}, trajectory)
    assert finding.text == (
        "The lidar is not where its mount says, relative to the axle: 9.0 ± 0.2 cm ahead, 0.0 ± 0.4 cm to the "
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
         "text": f"the {check} is wrong, as the scans around 1:12 saw"}
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
    summary = {"walls": 0, "scans": 100, "keyframes": 7, "slam": {"health": health}}
    assert reason in reason_without_walls(summary)
    assert reason_without_walls(summary | {"walls": 1}) == ""


def test_a_lidar_that_stays_in_one_place_is_named() -> None:
    summary = {"walls": 0, "scans": 100, "keyframes": 1, "slam": {"health": {}}}
    assert "the lidar stayed in one place" in reason_without_walls(summary)


# The command


def test_the_report_command_writes_the_page_of_an_older_session(wclm: Any, fake_slam: type) -> None:
    assert wclm("run", "sim:room?duration=3&lidar=short", "--out", "out", "--no-review").exit_code == 0
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
    wclm.refuses(
        "report", "out", "--overwrite", because=["out/summary.json: has no path_length, which every run writes"]
    )
    assert Path("out/report.html").read_text() == written


def test_results_are_kept_if_the_page_fails(
    wclm: Any, fake_slam: type, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object) -> None:
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("slam.visualisation.report_page.page.write_page", fails)
    result = wclm("run", "sim:room?duration=3&lidar=short", "--out", "out", "--no-review")
    assert isinstance(result.exception, ZeroDivisionError)
    present = {file.name for file in (tmp_path / "out").iterdir()}
    assert {"trajectory.tum", "map.json", "summary.json"} <= present
    assert not any("report" in name for name in present)


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
