"""Read parameters from YAML files as ROS 2 nodes do, and from the command line."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.events import AliasEvent

from ..errors import ConfigurationError

PARAMETERS = "ros__parameters"
ANY_NODE = frozenset({"/**", "**", "/*", "*"})


def load_parameters(files: Sequence[Path], assignments: Sequence[str], node: str) -> dict[str, Any]:
    """Return the values of all parameters for a node, later ones in place of earlier ones.

    files        in the format of ROS 2: names of nodes, each with `ros__parameters`; wildcards are possible
    assignments  NAME:=VALUE with a value in YAML; they take precedence
    node         absolute name of the node, with its namespace

    Raises ConfigurationError, which names the file or the assignment.
    """
    values: dict[str, Any] = {}
    for file in files:
        values |= _read(file, node)
    for assignment in assignments:
        name, separator, text = assignment.partition(":=")
        name = name.rpartition(":")[2]  # it may begin with the name of a node
        if not separator or not name:
            raise ConfigurationError(f"parameter {assignment!r}: must have the form NAME:=VALUE")
        values[name] = _parse(text, f"parameter {assignment!r}")
    return values


def _read(file: Path, node: str) -> dict[str, Any]:
    try:
        content = _parse(file.read_text(encoding="utf-8"), str(file))
    except OSError as error:
        raise ConfigurationError(f"{file}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise ConfigurationError(f"{file}: is not text in UTF-8") from error
    if not isinstance(content, Mapping):
        raise ConfigurationError(f"{file}: must contain the name of a node, and below it {PARAMETERS}")
    found = dict(_nodes(content, ""))
    chosen = [parameters for name, parameters in found.items() if _is_meant(name, node)]
    if not chosen:
        names = ", ".join(found) or "no node"
        raise ConfigurationError(f"{file}: has parameters of {names}, but not of {node}")
    if any(not isinstance(parameters, Mapping) for parameters in chosen):
        raise ConfigurationError(f"{file}: {PARAMETERS} must have names and values")
    return {str(name): value for parameters in chosen for name, value in parameters.items()}


def _nodes(content: Mapping[str, Any], namespace: str) -> Iterator[tuple[str, Any]]:
    """Yield the absolute name of each node and its parameters; namespaces may be nested."""
    for name, inner in content.items():
        path = f"{namespace}/{str(name).lstrip('/')}"
        if isinstance(inner, Mapping) and PARAMETERS in inner:
            yield path, inner[PARAMETERS]
        elif isinstance(inner, Mapping):
            yield from _nodes(inner, path)


def _is_meant(name: str, node: str) -> bool:
    """Return True if the name in a file is that of the node; without a namespace it is of the node in any."""
    return name in ANY_NODE or name == node or name == f"/{node.rpartition('/')[2]}"


def _parse(text: str, place: str) -> Any:
    """Return the content of YAML without aliases, which ROS 2 does not read either: a value may contain itself."""
    try:
        if any(isinstance(event, AliasEvent) for event in YAML(typ="safe").parse(text)):
            raise ConfigurationError(f"{place}: has aliases (*name), which parameters of ROS 2 cannot have")
        return YAML(typ="safe").load(text)
    except (YAMLError, ValueError, RecursionError) as error:
        raise ConfigurationError(f"{place}: invalid YAML: {' '.join(str(error).split())}") from error
