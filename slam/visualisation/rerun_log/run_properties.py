"""What a review log says of a run as a whole, besides its rows: its name, settings and summary, and the legend."""

from __future__ import annotations

from collections.abc import Mapping

import rerun as rr

from . import documents
from .rrd_writer import RrdWriter


def log_run_properties(
    writer: RrdWriter, config: str, recording: str, versions: Mapping[str, str], seed: int | None
) -> None:
    """Log the properties of a run at its begin, and the documents about it, of which the summary is still pending."""
    if recording:
        writer.set_name(recording)
    named = {"recording": recording or None, "seed": seed} | {k.replace("-", "_"): v for k, v in versions.items()}
    if properties := {name: value for name, value in named.items() if value is not None}:
        writer.set_properties("run", properties)
    writer.log_static("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    _log_document(writer, "legend", documents.legend())
    _log_document(writer, "config", documents.configuration(config, recording, versions))
    _log_document(writer, "summary", documents.SUMMARY_PENDING)


def log_summary(writer: RrdWriter, summary: Mapping[str, object]) -> None:
    """Log the summary of a run that has ended."""
    _log_document(writer, "summary", documents.summary(summary))


def _log_document(writer: RrdWriter, entity: str, markdown: str) -> None:
    writer.log_static(entity, rr.TextDocument(markdown, media_type=rr.MediaType.MARKDOWN))
