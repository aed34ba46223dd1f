"""Settings: properties of the sensors and choice of methods.

Tuning parameters of the algorithms are no settings but constants beside the algorithm, with their origin.
"""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, get_args

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from drivers.arguments import check_items, path_of
from drivers.messages import MAX_TURN_PERIOD

from .bounds import MAX_MOUNT, MAX_ODOMETRY_DEVIATION, MAX_TURN
from .errors import ConfigurationError, shortened

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

Finite = Annotated[float, Field(allow_inf_nan=False)]
Deviation = Annotated[float, Field(allow_inf_nan=False, le=MAX_ODOMETRY_DEVIATION)]
MountPosition = Annotated[float, Field(allow_inf_nan=False, ge=-MAX_MOUNT, le=MAX_MOUNT)]
MountHeading = Annotated[float, Field(allow_inf_nan=False, ge=-MAX_TURN, le=MAX_TURN)]


class Settings(BaseModel):
    """Group of settings; none is unknown, and true and false are no numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)

    @field_validator("*", mode="before")
    @classmethod
    def _is_of_its_kind(cls, value: Any, info: ValidationInfo) -> Any:
        kind = cls.model_fields[str(info.field_name)].annotation
        if isinstance(value, bool) and bool not in (kind, *get_args(kind)):
            raise ValueError("must not be true or false")
        return value


class LidarConfig(Settings):
    """Properties of the lidar, as in its data sheet."""

    sigma_range: float = Field(
        0.01,
        gt=0,
        lt=1,
        description="standard deviation of a range, metres; initial value if adapt_noise is true",
    )
    sigma_bearing: float = Field(
        math.radians(0.05),
        gt=0,
        lt=0.1,
        description="standard deviation of a beam's bearing, radians; for covariances, see adapt_noise",
    )
    range_bias: Finite = Field(
        0.0, gt=-1, lt=1, description="range bias, metres: all ranges are too long by it; see `wclm calibrate`"
    )
    adapt_noise: bool = Field(
        True,
        description="estimate sigma_range, and sigma_bearing for covariances, from the residuals of walls",
    )
    range_min: Finite = Field(0.05, ge=0, description="minimum range, metres; shorter ranges are ignored")
    range_max: float = Field(
        60.0,
        gt=0,
        description="maximum range, metres; longer ranges are ignored; the recording's own limit also applies",
    )
    mount: tuple[MountPosition, MountPosition, MountHeading] | None = Field(
        None,
        description="pose of the lidar on the base: x and y in metres, heading in radians; "
        "by default that of the recording, else zero",
    )

    beam_order: Literal["auto", "forward", "reversed"] = Field(
        "auto",
        description="order of the beams' times: 'forward' as they are stated, 'reversed', or 'auto': in a recording as "
        "its scans show, else as stated",
    )
    turn_period: Finite | None = Field(
        None,
        ge=0,
        lt=MAX_TURN_PERIOD,
        description="seconds in which the lidar turns once, if the times of beams are stated wrongly or not at all: "
        "they are then measured one after the other by their angles, counter-clockwise, or clockwise if beam_order is "
        "'reversed'; 0: all at once. By default as stated, in a recording as its scans show",
    )
    delay: float | None = Field(
        None,
        gt=-10,
        lt=10,
        description="seconds by which the lidar's stamps are late against odometry's, negative if early; by default "
        "that of the recording if it is significant and the turns from scan to scan do not contradict it, else zero",
    )
    topic: str = Field(
        "", description="topic of the scans or point clouds in a ROS recording; by default the best one with scans"
    )
    cut_height: Finite | None = Field(
        None,
        description="height above the origin of the base at which point clouds are cut, metres; by default that of the "
        "lidar",
    )
    cut_thickness: float = Field(
        0.2, gt=0, lt=10, description="thickness of the layer of point clouds that is used, metres"
    )

    @model_validator(mode="after")
    def _range_is_not_empty(self) -> Self:
        if self.range_min >= self.range_max:
            raise ValueError(f"range_min ({self.range_min:g}) must be less than range_max ({self.range_max:g})")
        return self


class SecondLidarConfig(LidarConfig):
    """The same for a second lidar, whose scans are joined with those of the first that are measured at that time."""

    topic: str = Field(
        "",
        description="topic of the second lidar's scans in a ROS recording, besides lidar.topic; "
        "by default there is no second lidar",
    )


class OdometryConfig(Settings):
    """Wheel odometry, and its standard deviations: drift over the travelled distance, and noise of a single reading."""

    source: Literal["wheels", "none"] = Field(
        "wheels",
        description="'none': there is no odometry, or it is ignored; motions are predicted at constant velocity and "
        "corrected by the scans. A recording without odometry sets it",
    )
    topic: str = Field(
        "", description="topic of the odometry in a ROS recording; by default the one with the most messages"
    )
    gyroscope: bool = Field(True, description="use the turns of a gyroscope, if there is one, instead of the wheels'")
    translation_error: Deviation = Field(0.1, ge=0, description="drift of the position, metres per metre")
    rotation_walk: Deviation = Field(
        0.06,
        ge=0,
        description="drift of the heading after one metre, radians; grows with the square root of the distance",
    )
    translation_floor: Deviation = Field(0.01, gt=0, description="noise of a position reading, metres")
    rotation_floor: Deviation = Field(math.radians(0.3), gt=0, description="noise of a heading reading, radians")
    learn: bool = Field(
        True, description="estimate the drift from registration while driving, starting from the values above"
    )


class FeatureConfig(Settings):
    """Methods of line extraction."""

    segmentation: Literal["split", "tracking"] = Field(
        "split", description="segmentation of a scan; 'tracking' is the line tracking of the WCLM paper"
    )
    estimator: Literal["wclm-ml", "wclm", "arras-siegwart", "siadat"] = Field(
        "wclm-ml", description="line estimator; 'wclm' is that of the WCLM paper"
    )


class MappingConfig(Settings):
    """When a scan becomes a keyframe. The CPU time goes with the number of keyframes."""

    keyframe_distance: Finite = Field(
        0.66,
        gt=0,
        description="metres driven between two keyframes; half of it where more than a tenth of a scan is new",
    )
    keyframe_turn: Finite = Field(
        math.radians(20.0), gt=0, description="radians turned between two keyframes; half of it likewise"
    )


class LoopClosureConfig(Settings):
    """Recognition of places that were mapped before."""

    enabled: bool = Field(True, description="search for loop closures and close them")


class PlanConfig(Settings):
    """How exact the walls of a plan are; gross errors are recognised and need not be covered."""

    sigma_offset: Finite = Field(0.03, gt=0, description="standard deviation of a wall across itself, metres")
    sigma_heading: Finite = Field(
        math.radians(0.3), gt=0, description="standard deviation of the direction of a wall, radians"
    )


class Config(Settings):
    """All settings. The defaults suit indoor lidars on a wheel base. A wrong one raises ConfigurationError."""

    lidar: LidarConfig = LidarConfig()
    odometry: OdometryConfig = OdometryConfig()
    features: FeatureConfig = FeatureConfig()
    mapping: MappingConfig = MappingConfig()
    loop_closure: LoopClosureConfig = LoopClosureConfig()
    plan: PlanConfig = PlanConfig()
    second_lidar: SecondLidarConfig = SecondLidarConfig()

    @model_validator(mode="wrap")
    @classmethod
    def _name_wrong_setting(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Raise ConfigurationError, with one line, instead of the error of the library."""
        try:
            return handler(data)
        except ValidationError as error:
            raise ConfigurationError(_name_and_reason(error.errors()[0])) from error

    def of_lidar(self, number: int) -> LidarConfig:
        """Return the properties of a lidar by its number, `Scan.lidar`."""
        return self.second_lidar if number else self.lidar

    def with_mount(self, mount: tuple[float, float, float]) -> Config:
        """Return these settings with a mount of the first lidar."""
        return self.model_copy(update={"lidar": self.lidar.model_copy(update={"mount": mount})})

    def with_two_lidars(self, first: str, second: str) -> Config:
        """Return these settings with two lidars, whose scans have these topics in recordings."""
        lidars = {"lidar": (self.lidar, first), "second_lidar": (self.second_lidar, second)}
        return self.model_copy(
            update={name: one.model_copy(update={"topic": topic}) for name, (one, topic) in lidars.items()}
        )

    def of_recording(self) -> dict[str, Any]:
        """Return the settings by which a recording is read and its scans are placed, as data of JSON."""
        lidars = {"lidar": self.lidar, **({"second_lidar": self.second_lidar} if self.second_lidar.topic else {})}
        data: dict[str, Any] = {name: lidar.model_dump() for name, lidar in lidars.items()}
        for lidar in data.values():
            lidar["range_max"] = lidar["range_max"] if math.isfinite(lidar["range_max"]) else "inf"  # no number in JSON
        return data | {"odometry": {"topic": self.odometry.topic}}

    def without_odometry(self) -> Config:
        """Return these settings for mapping by the scans alone."""
        return self.model_copy(update={"odometry": self.odometry.model_copy(update={"source": "none"})})

    @property
    def second_lidar_delay(self) -> float:
        """Seconds by which the second lidar's stamps are later than the first's; zero if its delay is not set."""
        second = self.second_lidar.delay
        return 0.0 if second is None else second - (self.lidar.delay or 0.0)


def load_config(path: Path | str | None = None, overrides: Iterable[str] = ()) -> Config:
    """Load settings from a TOML file, then apply overrides `group.key=value` in their order.

    Values of overrides are in TOML syntax; bare words are strings. Raises ConfigurationError, which names the file or
    override and the setting.
    """
    data: dict[str, Any] = {}
    check_items("overrides", overrides, str, "texts")
    if path is not None:
        file = path_of("path", path)
        try:
            data = tomllib.loads(file.read_text(encoding="utf-8"))
        except OSError as error:
            raise ConfigurationError(f"{path}: {error.strerror or error}") from error
        except (ValueError, RecursionError) as error:
            raise ConfigurationError(f"{path}: invalid TOML: {error}") from error
    config = validated_config(data, str(path))
    for override in overrides:
        name, equals, text = override.partition("=")
        group, dot, key = name.strip().partition(".")
        if not (equals and dot and group and key):
            raise ConfigurationError(
                f"--set {override}: must have the form group.key=value, e.g. lidar.sigma_range=0.02"
            )
        data.setdefault(group, {})[key] = _value(text)
        config = validated_config(data, f"--set {override}")
    return config


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        return text.strip()


def validated_config(data: Any, place: str) -> Config:
    """Return settings from plain data. Raises ConfigurationError, which names `place` and the setting."""
    try:
        return Config.model_validate(data)
    except ConfigurationError as error:
        raise ConfigurationError(f"{place}: {error}") from error


def _name_and_reason(error: ErrorDetails) -> str:
    """Return the name of a setting and why it is invalid."""
    location, kind, value = error["loc"], error["type"], error["input"]
    message = error["msg"].removeprefix("Value error, ")
    reason = message[:1].lower() + message[1:]
    if kind == "model_type":
        reason = "must be a group of settings"
    elif kind == "extra_forbidden":
        reason = f"no such setting; known are {', '.join(_names(location[:-1]))}"
    elif kind in ("tuple_type", "too_long") or (kind == "missing" and isinstance(location[-1], int)):
        location = location[:2]  # the setting, not a number of it
        reason = "must be a list of three numbers, e.g. [0.1,0,0]"
    elif isinstance(value, float) and not math.isfinite(value):
        reason = "input should be a finite number"
    return f"{shortened('.'.join(str(part) for part in location))}: {reason}"


def _names(location: tuple[int | str, ...]) -> list[str]:
    model: Any = Config
    for part in location:
        model = model.model_fields[part].annotation
    return list(model.model_fields)


def config_to_toml(config: Config) -> str:
    """Return the settings as TOML, as `load_config` reads it; a setting that is None becomes a comment."""
    lines: list[str] = []
    for group, values in config.model_dump().items():
        lines.append(f"[{group}]")
        for key, value in values.items():
            if value is None:
                lines.append(f"# {key}: not set")
            elif isinstance(value, bool | str | tuple):
                lines.append(f"{key} = {json.dumps(value)}")  # JSON and TOML have the same syntax here
            else:
                lines.append(f"{key} = {value!r}")
        lines.append("")
    return "\n".join(lines)
