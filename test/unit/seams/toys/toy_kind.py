"""A kind of action of somebody else's, ``{"say": TEXT}``: its form, its class, and how it is
done."""

from __future__ import annotations

from typing import Any, Dict, List, Mapping, NamedTuple

from gspn_framework_package.execution.actions import ActionContext, ActionResult
from gspn_framework_package.execution.local_kinds import LocalAction
from gspn_framework_package.model.data import fill
from gspn_framework_package.model.plan import Plan

said: List[Any] = []


class SayAction(NamedTuple):
    """Say ``message``, which may be a reference to data."""

    message: Any

    FORM = {
        "type": "object",
        "required": ["say"],
        "additionalProperties": False,
        "properties": {"say": {"type": ["string", "object"]}},
    }

    @property
    def label(self) -> str:
        """The name of the action for people."""
        return "say %s" % (self.message,)

    @classmethod
    def from_json(cls, place: str, data: Mapping[str, Any]) -> SayAction:
        """The action in a JSON object that fits the schema."""
        return cls(data["say"])

    def to_json(self) -> Dict[str, Any]:
        """The action as a JSON object."""
        return {"say": self.message}


def ready(plan: Plan, action: SayAction) -> LocalAction:
    """The action, ready to be done."""

    def do(context: ActionContext) -> ActionResult:
        message = fill(action.message, context.data)
        if message == "":
            raise ValueError("nothing to say")
        said.append(message)
        return ActionResult("", {"said": len(said)})

    return do
