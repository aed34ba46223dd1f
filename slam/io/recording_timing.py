"""Timing and mounting of a recording's lidar: what was found, what is corrected, and how commands say it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from drivers.messages import Source
from drivers.source_factory import recording_of, second_recording_of
from drivers.timing.beam_times import STATED, BeamTimes

if TYPE_CHECKING:
    from drivers.recordings.reader import RecordingReader
    from drivers.timing.beam_order import BeamOrderTest
    from drivers.timing.delay import Delay
    from drivers.timing.floor import Floor
    from drivers.timing.mount_heading import MountHeading
    from drivers.timing.own_returns import OwnReturns

    from ..config import Config, LidarConfig

DIFFERENT = 5.0
"""Standard deviations by which the delays of two lidars must differ to be different: most have one clock."""
UNKNOWN_MOUNT = "the mount of the lidar on the robot is not recorded; lidar.mount=[x,y,heading] states it"


@dataclass(frozen=True, slots=True)
class RecordingTiming:
    """Timing of a recording's lidar; nothing is known of simulations and devices.

    beam_times      times that the beams have when the recording is read
    order_test      comparison of times of the beams; None if it was not made
    delay           delay of the lidar as found; None if it was not looked for, or is not determined
    used_delay      seconds that are compensated
    mount_heading   direction that the lidar points in as found, if it contradicts the mount; else None
    stated_mount    mount of the lidar by the settings, else by the recording: x, y (metres), heading; None if neither
                    states one
    mount_unknown   true if nothing states it, although the odometry of the base is used
    earlier_mount   mount of the lidar in an earlier run, which is used as nothing else states it; else None
    turn_doubts     what is probably wrong with the turns of odometry, as lines of text
    floor           the floor that the lidar sees, whose returns are left out when the recording is read; None if none
    own_returns     returns from the robot itself, which are left out likewise; None if none
    """

    beam_times: BeamTimes = STATED
    order_test: BeamOrderTest | None = None
    delay: Delay | None = None
    used_delay: float = 0.0
    mount_heading: MountHeading | None = None
    stated_mount: tuple[float, float, float] | None = None
    mount_unknown: bool = False
    earlier_mount: tuple[float, float, float] | None = None
    turn_doubts: tuple[str, ...] = ()
    floor: Floor | None = None
    own_returns: OwnReturns | None = None

    @classmethod
    def of(cls, source: Source, lidar: LidarConfig | None = None) -> RecordingTiming:
        """Determine the timing of a source's lidar, with what the settings say of it; without them, by default."""
        return cls._of_reader(recording_of(source), lidar)

    @classmethod
    def of_second(cls, source: Source, lidar: LidarConfig) -> RecordingTiming | None:
        """Return the same of a second lidar; None if the source is no recording with two."""
        reader = second_recording_of(source)
        return None if reader is None else cls._of_reader(reader, lidar)

    @classmethod
    def _of_reader(cls, reader: RecordingReader | None, lidar: LidarConfig | None) -> RecordingTiming:
        set_delay = None if lidar is None else lidar.delay
        if reader is None:
            return cls(used_delay=set_delay or 0.0)
        test = reader.beam_order_test if reader.set_beam_times is None else None
        heading, mount = reader.mount_heading, None if lidar is None else lidar.mount
        if heading is not None and heading.stated is not None and mount is None:
            x, y, direction = heading.stated.tolist()
            mount = x, y, direction
        if heading is not None and not heading.contradicts(0.0 if mount is None else mount[2]):
            heading = None
        turns = reader.odometry_turns
        doubts = () if turns is None else tuple(turns.doubts(corrected=reader.reason_to_mirror is not None))
        delay, used = None, set_delay
        if used is None:
            delay = reader.delay
            used = delay.seconds if delay is not None and delay.objection is None else 0.0
        unknown = mount is None and reader.has_scans and reader.has_odometry and not reader.states_mount
        return cls(
            beam_times=reader.beam_times,
            order_test=test,
            delay=delay,
            used_delay=used,
            mount_heading=heading,
            stated_mount=mount,
            mount_unknown=unknown,
            turn_doubts=doubts,
            floor=reader.floor,
            own_returns=reader.own_returns,
        )

    @property
    def used_heading(self) -> float | None:
        """Heading of the mount that is used, radians, if neither recording nor settings state any; else None."""
        return None if self.mount_heading is None or self.stated_mount is not None else self.mount_heading.found

    def compensated(self, config: Config) -> Config:
        """Return the settings with the delay that is compensated, and the heading of a mount that is not stated."""
        update: dict[str, Any] = {}
        if self.used_delay and config.lidar.delay is None:
            update["delay"] = self.used_delay
        if self.used_heading is not None and config.lidar.mount is None:
            update["mount"] = (0.0, 0.0, self.used_heading)
        return config.model_copy(update={"lidar": config.lidar.model_copy(update=update)}) if update else config

    def beside(self, first: RecordingTiming) -> RecordingTiming:
        """Return the timing of a second lidar: with the delay of the first one, unless its own is clearly another."""
        if self.delay is None:
            return replace(self, used_delay=first.used_delay)
        seconds, sigma = (first.used_delay, 0.0) if first.delay is None else (first.delay.seconds, first.delay.sigma)
        differs = abs(self.delay.seconds - seconds) > DIFFERENT * math.hypot(self.delay.sigma, sigma)
        return self if differs else replace(self, used_delay=first.used_delay)

    def figures(self) -> dict[str, Any]:
        """Return the timing as plain data, for summary.json."""
        found = self.delay
        return {
            "beams_reversed": self.beam_times.reversed,
            "beams_turn": self.beam_times.turn,
            "delay": None if found is None else round(found.seconds, 4),
            "delay_sigma": None if found is None else round(found.sigma, 4),
            "compensated_delay": self.used_delay,
        }

    def findings(self) -> list[str]:
        """Return what was measured and needs no correction, as lines of text."""
        lines = []
        test = self.order_test
        if test is not None and test.pairs and test.stated_sweep > 0.0 and self.beam_times.as_stated:
            lines.append(f"beams in the stated order{_evidence(test)}")
        if self.delay is not None and self.delay.objection is not None:
            lines.append(f"{_late(self.delay.seconds, self.delay)}; not compensated: {self.delay.objection}")
        return lines

    def settings(self) -> list[str]:
        """Return settings that correct the same live, which cannot look ahead, as `lidar.delay=0.1650`."""
        times, settings = self.beam_times, []
        if times.reversed:
            settings.append("lidar.beam_order=reversed")
        if times.turn is not None:
            settings.append(f"lidar.turn_period={times.turn:.4g}")
        if self.used_delay:
            settings.append(f"lidar.delay={self.used_delay:.4f}")
        if self.used_heading is not None:
            settings.append(f"lidar.mount=[0,0,{self.used_heading:z.4f}]")
        if self.floor is not None:
            settings.append(f"lidar.range_max={self.floor.safe_range:.1f}")
        if self.own_returns is not None:
            settings.append(f"lidar.range_min={self.own_returns.safe_range:.1f}")
        return settings

    def corrections(self) -> list[str]:
        """Return what `wclm run` corrects, as lines of text."""
        lines = []
        if not self.beam_times.as_stated:
            lines.append(f"{_described(self.beam_times, self.order_test)}{_evidence(self.order_test)}")
        if self.used_delay:
            lines.append(f"{_late(self.used_delay, self.delay)}; compensated")
        if self.used_heading is not None:
            lines.append(f"lidar turned by {self._turn()} on the robot, as no mount is stated; corrected")
        if self.earlier_mount is not None:
            lines.append(mounted_as_in_session(self.earlier_mount))
        return lines

    def doubts(self) -> list[str]:
        """Return what is probably wrong with the times of beams, the lidar's mount or the turns of odometry, as lines
        of text.
        """
        times = [] if self.order_test is None else self.order_test.doubts()
        if self.mount_heading is None or self.stated_mount is None or self.turn_doubts:
            return [*times, *self.turn_doubts, *([UNKNOWN_MOUNT] if self.mount_unknown else [])]
        x, y, heading = self.stated_mount
        return [
            *times,
            f"the lidar seems to be turned by {self._turn()} on the robot, but by {math.degrees(heading):z.0f} by its "
            f"mount: set lidar.mount=[{x:z.3g},{y:z.3g},{self.mount_heading.found:z.2f}], or estimate it by "
            "`wclm calibrate`",
        ]

    def _turn(self) -> str:
        """Return the heading of the mount as found, as text."""
        assert self.mount_heading is not None
        found, sigma = (math.degrees(value) for value in (self.mount_heading.found, self.mount_heading.sigma))
        return f"{found:z.1f} ± {sigma:.1f} degrees"


def mounted_as_in_session(mount: tuple[float, float, float]) -> str:
    """Return where a lidar is mounted by the session that a run continues or localises in, as a line of text."""
    x, y, heading = mount
    place = f"x {x:z.3f} m, y {y:z.3f} m, heading {math.degrees(heading):z.1f} degrees"
    return f"lidar mounted at {place}, as in the session, as no mount is stated"


def timed(
    source: Source, config: Config, earlier_mount: tuple[float, float, float] | None = None
) -> tuple[Config, RecordingTiming, RecordingTiming | None]:
    """Return the settings with each lidar's delay that a source shows, if none is set, and the timing of each lidar.

    earlier_mount  of the lidar in the session that the run uses, which is probably the same: used if nothing states it
    """
    first = RecordingTiming.of(source, config.lidar)
    config = first.compensated(config)
    if earlier_mount is not None and first.mount_unknown and first.used_heading is None:
        config = config.with_mount(earlier_mount)
        first = replace(first, mount_unknown=False, earlier_mount=earlier_mount)
    second = RecordingTiming.of_second(source, config.second_lidar)
    if second is None:
        return config, first, None
    if config.second_lidar.delay is None:
        second = second.beside(first)
    update: dict[str, Any] = {"delay": second.used_delay}
    if second.used_heading is not None and config.second_lidar.mount is None:
        update["mount"] = (0.0, 0.0, second.used_heading)
    lidar = config.second_lidar.model_copy(update=update)
    return config.model_copy(update={"second_lidar": lidar}), first, second


def _described(times: BeamTimes, test: BeamOrderTest | None) -> str:
    """Return when beams are measured, in contrast to the stated times, as the beginning of a line of text."""
    if times.turn is None:
        return "beams in the opposite of the stated order"
    direction = "clockwise" if times.reversed else "counter-clockwise"
    measured = "all at once" if times.turn == 0.0 else f"over {direction} turns of {times.turn:.3f} s"
    if test is None:
        return f"beams measured {measured}, as set"
    stated = test.stated_sweep
    contrast = f"instead of in the stated {stated:.3g} s" if stated > 0.0 else "though no times are stated"
    return f"beams measured {measured} {contrast}"


def _evidence(test: BeamOrderTest | None) -> str:
    """Return how the order of the beams is known, as the end of a line of text; empty if it is set."""
    if test is None:
        return ""
    if test.times is None:
        return "; the scans do not show whether that is right"
    return f", by {test.statistic:.1f} standard errors over {test.pairs} pairs of scans"


def _late(seconds: float, found: Delay | None) -> str:
    """Return a delay as text, with the standard deviation if it was found in the recording."""
    deviation = "" if found is None else f" ± {found.sigma:.3f}"
    return f"lidar {abs(seconds):.3f}{deviation} s {'early' if seconds < 0.0 else 'late'} against odometry"
