"""Writes the pages that say what can be typed: docs/commands.md and docs/configuration.md, out of the code itself.

    python docs/tools/reference.py      (or: make reference)

They are kept in the repository, where they can be read without building anything; a test fails where one is out of
date.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import typer
from typer.cli import get_docs_for_click
from typer.main import get_command

from drivers.devices.device_spec import COMMON_OPTIONS, DEVICE_KINDS, Option
from slam.cli.app import app
from slam.config import Config, config_to_toml

DOCS = Path(__file__).parents[1]
WRITTEN = "<!-- Written by docs/tools/reference.py; change the code and run `make reference`. -->"


def commands() -> str:
    """The page of commands: what `wclm COMMAND --help` says of each."""
    command = get_command(app)
    _abridge(command)
    text = get_docs_for_click(obj=command, ctx=typer.Context(command, info_name="wclm"), name="wclm", title="Commands")
    text = re.sub(r"\[bold\](.*?)\[/bold\]", r"`\1`", text)
    return f"{WRITTEN}\n\n{text.strip()}\n"


def _abridge(group: Any) -> None:
    """Let lists of commands say the first sentence of each, whole."""
    for command in getattr(group, "commands", {}).values():
        command.short_help = " ".join((command.help or "").split("\n\n")[0].split())
        _abridge(command)


def configuration() -> str:
    """The page of settings and of devices' options."""
    return "\n".join(
        [
            WRITTEN,
            "",
            "# Settings",
            "",
            "Nothing has to be set. What a data sheet states about the sensors can be, in a TOML file with "
            "`--config FILE`, or one by one with `--set GROUP.KEY=VALUE`; the latter come last. What is not known here "
            "is refused by name. The settings in effect are in the `config.toml` that every run leaves, and can be "
            "given to the next run. What an algorithm tunes is no setting: it is a constant beside the algorithm, with "
            "its reason.",
            "",
            *_settings(),
            "## All defaults",
            "",
            "```toml",
            config_to_toml(Config()).strip(),
            "```",
            "",
            "## Options of devices",
            "",
            "They follow the device's place in its spec, such as "
            "`rplidar:/dev/ttyUSB0?mount=0.1,0,3.1416&upside_down=1`; [more on specs](devices.md).",
            "",
            *_devices(),
        ]
    )


def _settings() -> list[str]:
    """A table for each group of settings, out of the pydantic models' own schema."""
    schema = Config.model_json_schema()
    lines = []
    for group, field in Config.model_fields.items():
        model: Any = field.annotation
        about = (model.__doc__ or "").strip().splitlines()[0]
        properties = schema["$defs"][model.__name__]["properties"]
        lines += [f"## `[{group}]`", "", about, "", "| key | default | allowed | meaning |", "|---|---|---|---|"]
        for key, value in properties.items():
            lines.append(f"| `{key}` | {_default(value)} | {_allowed(value)} | {_cell(value['description'])} |")
        lines.append("")
    return lines


def _default(value: dict[str, Any]) -> str:
    default = value.get("default")
    if default is None:
        return "not set"
    if isinstance(default, bool):
        return f"`{str(default).lower()}`"
    return f"`{default:.6g}`" if isinstance(default, float) else f"`{default}`"


def _allowed(value: dict[str, Any]) -> str:
    """What the schema says of a value, in words."""
    if "enum" in value:
        return ", ".join(f"`{choice}`" for choice in value["enum"])
    if "anyOf" in value:
        return " or ".join(_allowed(choice) for choice in value["anyOf"] if choice["type"] != "null")
    if value["type"] == "array":
        return f"{value['minItems']} numbers"
    if value["type"] == "boolean":
        return "`true`, `false`"
    names = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    return ", ".join(f"{sign} {value[name]:g}" for name, sign in names.items() if name in value) or "any number"


def _devices() -> list[str]:
    """Which kinds there are, and what each takes."""
    lines = ["| kind | devices | needs | takes, too |", "|---|---|---|---|"]
    for name, kind in DEVICE_KINDS.items():
        needs = ", ".join(f"`{option}`" for option in kind.required) or "nothing"
        takes = ", ".join(f"`{option}`" for option in kind.options if option not in (*kind.required, *COMMON_OPTIONS))
        lines.append(f"| `{name}` | {_cell(kind.description)} | {needs} | {takes} |")
    options: dict[str, tuple[Option, list[str]]] = {}
    for name, kind in DEVICE_KINDS.items():
        for key, option in kind.options.items():
            options.setdefault(key, (option, []))[1].append(name)
    lines += ["", "| option | of | meaning |", "|---|---|---|"]
    for key, (option, names) in options.items():
        lines.append(f"| `{key}` | {_group(names)} | {_cell(option.description)} |")
    return [*lines, ""]


def _group(names: list[str]) -> str:
    groups = {
        "all": list(DEVICE_KINDS),
        "lidars": [name for name, kind in DEVICE_KINDS.items() if kind.is_lidar],
        "bases": [name for name, kind in DEVICE_KINDS.items() if not kind.is_lidar],
    }
    listed = ", ".join(f"`{name}`" for name in names)
    return next((group for group, members in groups.items() if members == names), listed)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


PAGES = {"commands.md": commands, "configuration.md": configuration}


def main() -> None:
    """Write all pages."""
    for name, page in PAGES.items():
        (DOCS / name).write_text(page(), encoding="utf-8", newline="\n")
        sys.stdout.write(f"docs/{name}\n")


if __name__ == "__main__":
    main()
