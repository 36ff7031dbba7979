"""The definitions of a topological_navigation map for ROS 2 that all of its edges share."""

from __future__ import annotations

import re
from typing import Any, Mapping, Optional, Tuple


class MapDefinitions:
    """The actions that a map names, and what its ``${...}`` stands for."""

    _WORD = re.compile(r"\$\{([\w.]+)\}")

    def __init__(self, data: Mapping[str, Any]) -> None:
        self._data = data
        frame = self._find("transformation.topo_frame_id")
        self.frame = frame if isinstance(frame, str) else "map"

    def _find(self, path: str) -> Any:
        found: Any = self._data
        for step in path.split("."):
            found = found.get(step) if isinstance(found, dict) else None
        return found

    def filled(self, value: Any) -> Any:
        """Replace what the map defines; ``${node...}`` becomes ``$node...``, for later."""
        if isinstance(value, dict):
            return {str(key): self.filled(part) for key, part in value.items()}
        if isinstance(value, list):
            return [self.filled(part) for part in value]
        word = self._WORD.fullmatch(value) if isinstance(value, str) else None
        if word is None:
            return value
        if word.group(1).startswith("node."):
            return "$" + word.group(1).replace("node.nav_frame", "node.parent_frame")
        found = self._find(word.group(1))
        return value if found is None else found

    def action(self, name: str) -> Tuple[str, Optional[str], Optional[Mapping[str, Any]]]:
        """The server, the type and the goal of an action."""
        actions = self._data.get("actions")
        given = actions.get(name) if isinstance(actions, dict) else None
        if not isinstance(given, dict):
            return name, None, None
        goal = self.filled(given.get("action_goal_template"))
        return (
            str(given.get("action_server") or name),
            str(given["action_type"]) if given.get("action_type") else None,
            goal if isinstance(goal, dict) and goal else None,
        )
