"""The report page composes the commands for corrections of what is chosen on it."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path

from slam.events import Finished
from slam.io.output_dir import SESSION
from slam.io.sessions.session import HEADER
from slam.visualisation.report_page import write_page

from ..chromium import in_a_browser, render
from .report_pages import make, page

PROBE = """
<script>
const told = {};
const svg = document.querySelector("#map svg"), slider = document.querySelector(".time input");
const offers = () => [...document.querySelectorAll(".offers button")];
const accept = (label) => offers().find((one) => one.textContent === label).click();
const command = () => document.querySelector(".composed").textContent;
const isHidden = () => document.querySelector(".command").hidden;
const choose = (wall) => {
  const box = svg.querySelector(`.walls [data-wall="${wall}"]`).getBoundingClientRect();
  const x = box.left + box.width / 2, y = box.top + box.height / 2;
  svg.dispatchEvent(new MouseEvent("click", {clientX: x, clientY: y, bubbles: true}));
};
const goTo = (seconds) => {
  slider.value = seconds;
  slider.dispatchEvent(new Event("input"));
};
told.before = isHidden();
for (const loop of [5, 7]) {
  document.querySelector(`tr[data-loop="${loop}"]`).click();
  offers()[0].click();
}
told.loops = command();
document.querySelector('[data-zoom="0"]').click();
svg.scrollIntoView({block: "center"});
choose(0);
told.first = offers().map((one) => one.textContent);
choose(3);
accept("Wall 3 is no wall");
accept("Walls 0 and 3 are one");
accept("Walls 0 and 3 are one");
told.walls = command();
const [copy, clear] = document.querySelectorAll(".command button");
clear.click();
told.cleared = isHidden();
const [mark, join] = document.querySelectorAll(".places button");
told.join = join.hidden;
goTo(2);
mark.click();
join.click();
told.same = isHidden();
goTo(8);
join.click();
told.places = command();
copy.click();
told.selected = getSelection().toString();
document.documentElement.dataset.told = JSON.stringify(told);
</script>
"""


@in_a_browser
def test_chosen_loops_walls_and_places_become_options_of_a_command(tmp_path: Path, finished: Finished) -> None:
    folder = tmp_path / "it's a map"
    results = make(folder, finished)
    (folder / SESSION).mkdir(exist_ok=True)
    (folder / SESSION / HEADER).touch()
    write_page(folder / "report.html", results)
    text = (folder / "report.html").read_text(encoding="utf-8")
    text = re.sub("'sha256-[^']*'", "'unsafe-inline'", text)  # admits the script of the test
    (folder / "report.html").write_text(text.replace("</body>", PROBE + "</body>"), encoding="utf-8")
    document, console = render(folder / "report.html")
    assert console == []
    told = json.loads(html.unescape(re.search(r'data-told="(.*?)"', document).group(1)))
    start = f"wclm correct '{tmp_path}/it'\\''s a map'"
    assert told["before"]
    assert told["loops"] == f"{start} --forbid-loop 5 --close 7"  # 5 was closed, 7 rejected
    assert told["first"] == ["Wall 0 is no wall"]
    assert told["walls"] == f"{told['loops']} --delete-wall 3 --tie 0,3"
    assert told["cleared"]
    assert told["join"]  # no place is marked yet
    assert told["same"]
    stamps = [float(results.trajectory.stamps[0]) + seconds for seconds in (2.0, 8.0)]
    assert told["places"] == f"{start} --close {stamps[0]:.1f}s,{stamps[1]:.1f}s"
    assert told["selected"] == told["places"]


def test_without_a_session_no_correction_is_offered(tmp_path: Path, finished: Finished) -> None:
    assert 'id="correct"' not in page(tmp_path / "out", finished)
