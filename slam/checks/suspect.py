"""A place in a finished run where something is probably wrong."""

from __future__ import annotations

from drivers.elapsed import elapsed
from drivers.immutable import immutable

from ..geometry.segments import Floats

# Seconds from which the interval of a suspect is stated besides its time. Origin: chosen, for readability.
MIN_INTERVAL = 1.0
# Names of the checks. Origin: definition.
PLACEMENT, ODOMETRY, MAP, PARTS, UNCONSTRAINED = "placement", "odometry", "map", "parts", "unconstrained"


@immutable
class Suspect:
    """A place in a finished run where path, scans and odometry contradict each other.

    check     PLACEMENT (of a scan), ODOMETRY, MAP, PARTS (of the map that are not connected), or
              UNCONSTRAINED (a motion that no scan measures)
    stamp     seconds, where the contradiction is largest
    first     seconds, begin of the interval
    last      seconds, end of the interval
    position  (2,) in the map at `stamp`, metres
    weight    size of the contradiction relative to the least that is reported
    text      sentence with the figures, without the time; other times in it are since the start of the run
    """

    check: str
    stamp: float
    first: float
    last: float
    position: Floats
    weight: float
    text: str

    def sentence(self, start: float) -> str:
        """Return time and text, as shown to the user; `start` is the stamp (seconds) from which times are counted."""
        first, last = elapsed(self.first - start), elapsed(self.last - start)
        interval = f" ({first} to {last})" if self.last - self.first >= MIN_INTERVAL else ""
        return f"at {elapsed(self.stamp - start)}: {self.text}{interval}"

    def row(self, start: float) -> dict[str, object]:
        """Return the suspect as plain data for `summary.json`; `start`: see `sentence`."""
        return {
            "check": self.check,
            "stamp": self.stamp,
            "first": self.first,
            "last": self.last,
            "position": [round(float(value), 3) for value in self.position],
            "weight": round(self.weight, 3),
            "text": self.text,
            "sentence": self.sentence(start),
        }
