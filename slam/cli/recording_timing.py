"""Timing of a recording's lidar: what was found, what is corrected, and how commands say it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from drivers.messages import Source
from drivers.source_factory import recording_of

from ..config import Config, LidarConfig

if TYPE_CHECKING:
    from drivers.timing.beam_order import BeamOrderTest
    from drivers.timing.delay import Delay


@dataclass(frozen=True, slots=True)
class RecordingTiming:
    """Timing of a recording's lidar; nothing is known of simulations and devices.

    beams_reversed  if the beams' times are reversed when the recording is read
    order_test      comparison of their orders; None if it was not made
    delay           delay of the lidar as found; None if it was not looked for, or is not determined
    used_delay      seconds that are compensated
    """

    beams_reversed: bool = False
    order_test: BeamOrderTest | None = None
    delay: Delay | None = None
    used_delay: float = 0.0

    @classmethod
    def of(cls, source: Source, lidar: LidarConfig) -> RecordingTiming:
        """Determine the timing of a source's lidar, with what the settings say of it."""
        reader = recording_of(source)
        if reader is None:
            return cls(used_delay=lidar.delay or 0.0)
        test = reader.beam_order_test if lidar.beam_order == "auto" else None
        if lidar.delay is not None:
            return cls(reader.beams_reversed, test, None, lidar.delay)
        delay = reader.delay
        used = delay.seconds if delay is not None and delay.objection is None else 0.0
        return cls(reader.beams_reversed, test, delay, used)

    def compensated(self, config: Config) -> Config:
        """Return the settings with the delay that is compensated."""
        if not self.used_delay or config.lidar.delay is not None:
            return config
        return config.model_copy(update={"lidar": config.lidar.model_copy(update={"delay": self.used_delay})})

    def figures(self) -> dict[str, Any]:
        """Return the timing as plain data, for summary.json."""
        found = self.delay
        return {
            "beams_reversed": self.beams_reversed,
            "delay": None if found is None else round(found.seconds, 4),
            "delay_sigma": None if found is None else round(found.sigma, 4),
            "compensated_delay": self.used_delay,
        }

    def findings(self) -> list[str]:
        """Return what was found, as lines of text."""
        lines = []
        if self.order_test is not None:
            lines.append(_order_text(self.order_test))
        if self.delay is not None:
            objection = self.delay.objection
            verdict = "compensated by `wclm run`" if objection is None else f"not compensated: {objection}"
            value = f"{self.delay.seconds:+.3f} ± {self.delay.sigma:.3f} s"
            lines.append(f"lidar {value} late against odometry, {verdict}")
        return lines


def _order_text(test: BeamOrderTest) -> str:
    """Return the result of the comparison of the beams' orders as text."""
    if test.order is None:
        return "beams in the stated order; the scans do not show whether that is right"
    evidence = f"by {abs(test.statistic):.1f} standard errors over {test.pairs} pairs of scans"
    if test.order == "forward":
        return f"beams in the stated order, {evidence}"
    return f"beams measured in the opposite of the stated order, {evidence}; corrected"


def format_corrections(figures: dict[str, Any] | None) -> list[str]:
    """Return a line of text for each correction, from the timing in summary.json if there is any."""
    lines: list[str] = []
    if figures is None:
        return lines
    if figures["beams_reversed"]:
        lines.append("beams taken in the opposite of the stated order (lidar.beam_order)")
    if used := figures["compensated_delay"]:
        sigma = figures["delay_sigma"]
        value = f"{used:+.3f} s" if sigma is None else f"{used:+.3f} ± {sigma:.3f} s"
        lines.append(f"lidar {value} late against odometry, compensated (lidar.delay)")
    return lines
