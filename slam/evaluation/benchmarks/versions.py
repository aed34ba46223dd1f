"""Figures of released versions, as `wclm bench slam --json` wrote them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ...errors import MapError


def read_versions(folder: Path) -> dict[str, list[dict[str, Any]]]:
    """The drives of each version, in the order of the versions. Raises MapError naming a file that is none of these."""
    found: dict[str, list[dict[str, Any]]] = {}
    for path in folder.glob("*.json"):
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            found[content["versions"]["wclm-slam"]] = list(content["drives"])
        except (OSError, UnicodeDecodeError, json.JSONDecodeError, KeyError, TypeError) as error:
            raise MapError(f"{path}: is not what `wclm bench slam --json` writes") from error
    return {version: found[version] for version in sorted(found, key=_order)}


def _order(version: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part) for part in version.replace("-", ".").split(".")]
