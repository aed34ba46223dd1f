"""What a closure compared and what it did: two constellations laid on one another, the map before, and the shifts."""

from __future__ import annotations

import numpy as np
import rerun as rr

from ...events import ComparedWalls, Correction, LoopDecided
from ...geometry.segments import Floats
from . import colours
from .recording import Recording
from .shapes import Layer, lift

_THIN, _THICK, _THICKER = rr.Radius.ui_points(0.7), rr.Radius.ui_points(1.3), rr.Radius.ui_points(2.2)


class CorrectionLayer:
    """Logs what belongs to a decision, besides the decision."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        styles = {
            "world/before/walls": rr.LineStrips3D.from_fields(radii=_THICK, colors=colours.BEFORE),
            "world/before/path": rr.LineStrips3D.from_fields(radii=_THICK, colors=colours.BEFORE),
            "world/shift": rr.Arrows3D.from_fields(radii=_THIN, colors=colours.CLOSURE, show_labels=False),
            "match/old": rr.LineStrips3D.from_fields(radii=_THICK, colors=colours.WALL),
            "match/before": rr.LineStrips3D.from_fields(radii=_THICK, colors=colours.BEFORE),
            "match/aligned": rr.LineStrips3D.from_fields(radii=_THICKER, show_labels=False),
            "match/moved": rr.LineStrips3D.from_fields(radii=_THIN, colors=colours.BEFORE),
        }
        for entity, style in styles.items():
            recording.keep(entity, style)
        recording.keep("match", rr.ViewCoordinates.RIGHT_HAND_Z_UP)

    def log(self, event: LoopDecided) -> None:
        """Log what a decision compared, and what it did to the map, if it did."""
        if event.sight is not None:
            self._log_sight(event.sight)
        if event.correction is not None:
            self._log_correction(event.correction)

    def _log_sight(self, sight: ComparedWalls) -> None:
        """The recent walls where they were believed to be and where they would fall, about their common middle."""
        centre = sight.aligned.reshape(-1, 2).mean(axis=0)
        matched = sight.match >= 0
        shades = [colours.MATCHED if one else colours.NEW for one in matched.tolist()]
        labels = ["matched" if one else "not in the map" for one in matched.tolist()]
        moved = np.stack([sight.recent.mean(axis=1), sight.aligned.mean(axis=1)], axis=1)
        rows = {
            "old": rr.LineStrips3D.from_fields(strips=lift(sight.old - centre, Layer.WALL)),
            "before": rr.LineStrips3D.from_fields(strips=lift(sight.recent - centre, Layer.ODOMETRY)),
            "moved": rr.LineStrips3D.from_fields(strips=lift(moved - centre, Layer.ODOMETRY)),
            "aligned": rr.LineStrips3D.from_fields(
                strips=lift(sight.aligned - centre, Layer.FEATURE), colors=shades, labels=labels
            ),
        }
        for name, row in rows.items():
            self._recording.log(f"match/{name}", row)

    def _log_correction(self, correction: Correction) -> None:
        pieces, _ = correction.lines_before.piece_points()
        walls = rr.LineStrips3D.from_fields(strips=lift(pieces, Layer.ODOMETRY))
        self._recording.log("world/before/walls", walls)
        path = [lift(correction.keyframes_before, Layer.ODOMETRY)] if len(correction.keyframes) > 1 else []
        self._recording.log("world/before/path", rr.LineStrips3D.from_fields(strips=path))
        self._recording.log("world/shift", _arrows(correction.keyframes_before, correction.keyframes))


def _arrows(before: Floats, after: Floats) -> rr.Arrows3D:
    """From where each keyframe was to where it is, labelled with how far that is."""
    origins, tips = lift(before, Layer.LINK), lift(after, Layer.LINK)
    lengths = np.hypot(*(after - before)[:, :2].T)
    labels = [f"x{index} {length:.2f} m" for index, length in enumerate(lengths.tolist())]
    return rr.Arrows3D.from_fields(origins=origins, vectors=tips - origins, labels=labels)
