"""Read the benchmark figures of released versions, as written by `wclm bench slam --json`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ...errors import MapError


def read_versions(folder: Path) -> dict[str, list[dict[str, Any]]]:
    """Return the runs of each version, in the order of the versions. Raises MapError with the name of a bad file."""
    found: dict[str, list[dict[str, Any]]] = {}
    for path in folder.glob("*.json"):
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            found[content["versions"]["wclm-slam"]] = list(content["drives"])
        except (OSError, UnicodeDecodeError, json.JSONDecodeError, KeyError, TypeError) as error:
            raise MapError(f"{path}: not written by `wclm bench slam --json`") from error
    return {version: found[version] for version in sorted(found, key=_sort_key)}


def _sort_key(version: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part) for part in version.replace("-", ".").split(".")]
