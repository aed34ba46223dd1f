"""Names of a ROS 2 node: its namespace, and the remapping of topics and services."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

from ..errors import DriverError

DEFAULT_NODE = "slam_toolbox"
"""Name of the node of slam_toolbox: parameter files that were written for it fit this node, too."""
NAME = re.compile(r"(~/?|/)?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*|~/?|/")
"""Name of a topic, a service or a namespace."""
NODE_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


@dataclass(frozen=True, slots=True)
class NodeNames:
    """Name and namespace of a node, and its remappings.

    namespace   absolute
    remappings  pairs of names, applied in this order; the first that fits counts
    """

    node: str = DEFAULT_NODE
    namespace: str = "/"
    remappings: tuple[tuple[str, str], ...] = ()

    @classmethod
    def from_rules(cls, rules: Iterable[str]) -> Self:
        """Return the names from rules FROM:=TO as ROS 2 has them: __node, __ns, or a topic or service.

        Raises DriverError if a rule is invalid.
        """
        node, namespace, pairs = DEFAULT_NODE, "/", []
        for rule in rules:
            before, separator, after = rule.partition(":=")
            before = before.rpartition(":")[2] if separator else before  # a rule may begin with the name of a node
            is_node = before in ("__node", "__name")
            if not separator or not before or not (NODE_NAME if is_node else NAME).fullmatch(after):
                raise DriverError(f"remapping {rule!r}: must have the form FROM:=TO, with names of ROS 2")
            if is_node:
                node = after
            elif before == "__ns":
                namespace = after if after.startswith("/") else f"/{after}"
            else:
                pairs.append((before, after))
        return cls(node, namespace, tuple(pairs))

    @property
    def qualified(self) -> str:
        """Absolute name of the node."""
        return f"{self.namespace.rstrip('/')}/{self.node}"

    def resolve(self, name: str) -> str:
        """Return the absolute name of a topic or service, remapped; relative names are within the namespace."""
        absolute = self._absolute(name)
        for before, after in self.remappings:
            if self._absolute(before) == absolute:
                return self._absolute(after)
        return absolute

    def _absolute(self, name: str) -> str:
        if name.startswith("~"):
            return f"{self.qualified}/{name[1:].lstrip('/')}".rstrip("/")
        return name if name.startswith("/") else f"{self.namespace.rstrip('/')}/{name}"
