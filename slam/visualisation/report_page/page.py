"""Assemble the report page from its template and sections."""

from __future__ import annotations

from base64 import b64encode
from hashlib import sha256
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

from ...io.exports.svg_drawing import PATH_CLASSES, SIGMAS, UNKNOWN_CLASS, Drawing, draw_map
from ...io.output_dir import CONFIG, REPORT
from ...io.run_results import RunResults, read_run_results, refusing_damaged_summary
from ...io.unfinished_file import unfinished_file
from ...measuring.wall_map import WallMap
from . import sections
from .confidence import SWITCH, confidence_section
from .corrections import corrections_panel
from .findings import findings
from .joint import joint_element

HINT = "Click or touch a wall or corner to see its uncertainty."
HINT_TWO = "After two walls, their distance and angle are shown."


def write_page(path: Path, session: RunResults, wall_map: WallMap | None = None) -> None:
    """Write the page of a run. Raises MapError if its summary lacks entries that every run writes.

    wall_map  walls with their joint covariance: two walls that are chosen are measured
    """
    path.write_bytes(_encoded(session, wall_map))


def write_report_page(out: Path) -> None:
    """Write the report page of an output directory.

    Called when the other results are in place, so that they are not lost if it fails.
    """
    with unfinished_file(out / REPORT) as unfinished:
        write_page(unfinished, read_run_results(out))


def check_page(session: RunResults) -> None:
    """Raise MapError if the page of a run cannot be written, as the summary is damaged."""
    _encoded(session, None)


def _encoded(session: RunResults, wall_map: WallMap | None) -> bytes:
    """Return the content of the page. Raises MapError as `write_page` does."""
    with refusing_damaged_summary(session.path):
        return _page(session, wall_map).encode()


def _page(session: RunResults, wall_map: WallMap | None) -> str:
    summary, drawing = session.summary, draw_map(session, timed=True, confidence=True)
    extent = max(drawing.width, drawing.height)
    confidence = confidence_section(session, extent)
    run_findings = findings(summary, session.trajectory)
    settings = session.path / CONFIG
    colours = "".join(
        f".{c.name} {{ stroke: {c.colour}; color: {c.colour}; background: {c.colour} }}\n"
        for c in (*PATH_CLASSES, UNKNOWN_CLASS)
    )
    return Template(_part("page.html")).substitute(
        title=escape(str(summary["recording"])),
        style=_part("page.css") + colours,
        script=(script := _part("page.js") + _part("corrections.js")),
        script_hash=b64encode(sha256(script.encode()).digest()).decode(),
        facts=sections.facts(summary),
        view_box=drawing.view_box,
        aspect=f"{drawing.width:.3f} / {drawing.height:.3f}",
        map=drawing.elements,
        legend=_legend(drawing),
        successes=sections.successes(summary, run_findings),
        findings=sections.findings_list(run_findings, session.trajectory, extent),
        switch=SWITCH if confidence else "",
        confidence=confidence,
        joint=joint_element(wall_map),
        hint=HINT if wall_map is None else f"{HINT} {HINT_TWO}",
        correct=corrections_panel(session),
        duration=f"{session.trajectory.duration:.1f}",
        loops=sections.loops(summary.get("slam") or {}, float(session.trajectory.stamps[0])),
        corrections=sections.corrections(summary.get("corrections") or []),
        accuracy=sections.accuracy(summary.get("truth")),
        timings=sections.timings(summary),
        details=sections.details(summary, settings.read_text(encoding="utf-8") if settings.is_file() else ""),
    )


def _part(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


def _legend(drawing: Drawing) -> str:
    """Return the legend of the map symbols and of the path colours that occur."""
    path_entries = []
    for k, path_class in enumerate(PATH_CLASSES):
        if path_class in drawing.classes:
            last = k == len(PATH_CLASSES) - 1
            limit = (
                f"over {_centimetres(PATH_CLASSES[k - 1].below)}" if last else f"under {_centimetres(path_class.below)}"
            )
            path_entries.append((path_class.name, limit))
    if UNKNOWN_CLASS in drawing.classes:
        path_entries.append((UNKNOWN_CLASS.name, "path"))
    entries = "".join(f'<span><i class="{name}"></i>{text}</span>' for name, text in path_entries)
    if drawing.classes != (UNKNOWN_CLASS,):
        entries = f'</div><div class="legend"><span>σ of path and walls:</span>{entries}'
    marks = '<span><i class="wall"></i>wall</span><span><i class="band"></i>seen side</span>'
    marks += f'<span><i class="corner"></i>corner, {SIGMAS:.0f}σ</span>'
    if "data-loop" in drawing.elements:
        marks += '<span><i class="loop"></i>loop closure</span>'
    return f'{marks}<span class="start">○ start</span><span class="end">▲ end</span>{entries}'


def _centimetres(metres: float) -> str:
    return f"{100 * metres:g} cm"
