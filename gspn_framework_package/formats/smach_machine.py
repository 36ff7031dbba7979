"""Describes a state machine of SMACH, and runs its states one by one, as its plan says.

SMACH itself is not imported here: the file that makes the machine has done so.
"""

from __future__ import annotations

import importlib
import inspect
from typing import Any, Callable, Dict, Iterator, Mapping, Optional, Tuple

from gspn_framework_package.model.outcome import Outcome

StatePath = Tuple[str, ...]
"""The labels that lead from the machine to a state."""

Lines = Mapping[int, Tuple[str, int]]
"""Where each state was made (file and line), by its ``id()``."""

_RECORDED = "_gspn_arguments"
"""The attribute of a SimpleActionState that was made without its client: its arguments."""

_NEEDS_USERDATA = (
    "goal_key",
    "goal_slots",
    "goal_cb",
    "result_key",
    "result_slots",
    "result_cb",
    "input_keys",
    "output_keys",
    "outcomes",
)


def why_one_action(state: Any) -> str:
    """Why a container is one action, with everything in it; "" if it is not, or is no container."""
    smach = importlib.import_module("smach")
    if not isinstance(state, smach.container.Container):
        return ""
    run, step = type(state).execute, getattr(type(state), "_update_once", None)
    if run is smach.StateMachine.execute and step is smach.StateMachine._update_once:
        return ""
    if run is smach.Iterator.execute:
        if callable(state._items) or not hasattr(state._items, "__len__"):
            return "what it iterates over is known only when it runs"
        return ""
    if isinstance(state, smach.Concurrence):
        return "its states run at the same time"
    return "its class is not one of SMACH"


def iterates(state: Any) -> bool:
    """Whether a container is an Iterator, which is not a state machine."""
    return not hasattr(state, "_transitions")


def breaks(iterator: Any, outcome: str) -> bool:
    """Whether an Iterator ends with an outcome of its state."""
    loops = iterator._loop_outcomes
    return outcome in iterator._break_outcomes or bool(loops and outcome not in loops)


# --- description


def describe_machine(state: Any, lines: Lines) -> Dict[str, Any]:
    """Describe a state and those in it, as :mod:`gspn_framework_package.making.python_machine`
    reads it."""
    smach = importlib.import_module("smach")
    found: Dict[str, Any] = {
        "class": type(state).__qualname__,
        "line": lines.get(id(state)),
        "outcomes": sorted(state.get_registered_outcomes()),
        "keys": sorted({*state.get_registered_input_keys(), *state.get_registered_output_keys()}),
        "why": why_one_action(state),
        "action": _action(state),
    }
    if not isinstance(state, smach.container.Container) or found["why"]:
        return found
    found["callbacks"] = bool(state._start_cbs or state._transition_cbs or state._termination_cbs)
    children = state.get_children()
    found["states"] = {str(label): describe_machine(children[label], lines) for label in children}
    if iterates(state):
        outcomes = state._state.get_registered_outcomes()
        found["items"] = len(state._items)
        found["breaks"] = sorted(o for o in outcomes if breaks(state, o))
        found["exhausted"] = state._exhausted_outcome
        found["outcome_of"] = dict(state._final_outcome_map)
    else:
        try:
            state.check_consistency()
        except smach.InvalidTransitionError as error:
            found["inconsistent"] = " ".join(str(error).split())
        found["initial"] = state._initial_state_label
        found["transitions"] = {label: dict(to) for label, to in state._transitions.items()}
    return found


def _action(state: Any) -> Optional[Dict[str, Any]]:
    """The action server that a SimpleActionState calls with the same goal each time."""
    arguments = getattr(state, _RECORDED, None)
    if arguments is None or _needs_userdata(arguments):
        return None
    limit = arguments.get("exec_timeout")
    return {
        "server": arguments["action_name"],
        "type": arguments["action_spec"]._type,
        "goal": _fields(arguments.get("goal")),
        "timeout": limit.to_sec() if limit else None,
    }


def _needs_userdata(arguments: Mapping[str, Any]) -> bool:
    return any(arguments.get(name) for name in _NEEDS_USERDATA)


def _fields(message: Any) -> Any:
    """The fields of a message that differ from a new one, as in a plan; times are ``now``."""
    if isinstance(message, bytes):
        return list(message)
    if isinstance(message, (list, tuple)):
        return [_fields(each) for each in message]
    if not hasattr(message, "__slots__"):
        return {} if message is None else message
    if hasattr(message, "to_sec"):
        return "now" if type(message).__name__ == "Time" else _slots(message)
    fresh = type(message)()
    changed = {s: v for s, v in _slots(message).items() if v != getattr(fresh, s)}
    return {slot: _fields(value) for slot, value in changed.items()}


def _slots(message: Any) -> Dict[str, Any]:
    return {slot: getattr(message, slot) for slot in message.__slots__}


def recording(make: Callable[..., None], always: bool) -> Callable[..., None]:
    """The ``__init__`` of a SimpleActionState that makes no client if the plan calls the server.

    :param make: the one that makes it.
    :param always: never make a client: nothing is going to run here.
    """
    smach = importlib.import_module("smach")
    signature = inspect.signature(make)

    def begin(state: Any, *more: Any, **named: Any) -> None:
        bound = signature.bind(state, *more, **named).arguments
        if not always and _needs_userdata(bound):
            make(state, *more, **named)
            return
        keys = {name: list(bound.get(name) or ()) for name in ("input_keys", "output_keys")}
        for name, key in (("input_keys", "goal"), ("output_keys", "result")):
            keys[name] += [bound[key + "_key"]] if bound.get(key + "_key") else []
            keys[name] += bound.get(key + "_slots") or ()
        ends = (Outcome.SUCCEEDED, Outcome.ABORTED, Outcome.PREEMPTED)
        outcomes = [*(end.value for end in ends), *(bound.get("outcomes") or ())]
        smach.State.__init__(state, outcomes=outcomes, **keys)
        setattr(state, _RECORDED, dict(bound))

    return begin


# --- states one by one


class MachineRun:
    """A machine whose states are run one by one; SMACH decides how their userdata is passed on.

    :param root: the machine.
    """

    def __init__(self, root: Any) -> None:
        self._root = root
        self._items: Dict[StatePath, Iterator[Any]] = {}
        self._next: StatePath = ()  # the state that comes next, by what has been run here
        self._enter(())

    def execute(self, path: StatePath, on_cancel: Callable[[Callable[[], None]], None]) -> str:
        """Run a state, and return its outcome.

        :param on_cancel: receives the function to call if the state should end early.
        """
        if path != self._next:
            self._catch_up(path)
        state = self._at(path)
        on_cancel(state.request_preempt)
        outcome = state.execute(self._userdata(path))
        state.recall_preempt()
        self._leave(path, outcome)
        return str(outcome)

    def _at(self, path: StatePath) -> Any:
        state = self._root
        for label in path:
            state = state.get_children()[label]
        return state

    def _userdata(self, path: StatePath) -> Any:
        """The userdata of a state."""
        smach = importlib.import_module("smach")
        if not path:
            return smach.UserData()
        around, state = self._at(path[:-1]), self._at(path)
        if iterates(around):
            return around.userdata
        return smach.Remapper(
            around.userdata,
            state.get_registered_input_keys(),
            state.get_registered_output_keys(),
            around._remappings[path[-1]],
        )

    def _copy_in(self, path: StatePath) -> None:
        around = self._at(path)
        around._copy_input_keys(self._userdata(path), around.userdata)
        if iterates(around):
            self._items[path] = iter(around._items)

    def _copy_out(self, path: StatePath) -> None:
        around = self._at(path)
        around._copy_output_keys(around.userdata, self._userdata(path))

    def _enter(self, path: StatePath) -> None:
        around = self._at(path)
        if not hasattr(around, "get_children") or why_one_action(around):
            self._next = path
            return
        self._copy_in(path)
        if iterates(around):
            self._iterate(path)
        else:
            self._enter((*path, around._initial_state_label))

    def _iterate(self, path: StatePath) -> None:
        around = self._at(path)
        for item in self._items[path]:
            around.userdata[around._items_label] = item
            self._enter((*path, around._state_label))
            return
        self._end_iterator(path, around._exhausted_outcome)

    def _end_iterator(self, path: StatePath, outcome: str) -> None:
        self._copy_out(path)
        self._leave(path, self._at(path)._final_outcome_map.get(outcome, outcome))

    def _leave(self, path: StatePath, outcome: str) -> None:
        """Go where the outcome of a state leads."""
        if not path:
            self._next = ()
            return
        above = path[:-1]
        around = self._at(above)
        if iterates(around):
            if breaks(around, outcome):
                self._end_iterator(above, outcome)
            else:
                self._iterate(above)
            return
        target = around._transitions[path[-1]][outcome]
        if target in around._states:
            self._enter((*above, target))
            return
        self._copy_out(above)
        self._leave(above, target if target in around.get_registered_outcomes() else outcome)

    def _catch_up(self, path: StatePath) -> None:
        """Leave and enter the containers in between, where others have run the last states."""
        stays = 0
        while stays < min(len(path), len(self._next)) and path[stays] == self._next[stays]:
            stays += 1
        for length in range(len(self._next) - 1, stays, -1):
            self._copy_out(self._next[:length])
        for length in range(stays + 1, len(path)):
            self._copy_in(path[:length])
            around = self._at(path[:length])
            if iterates(around):
                for item in self._items[path[:length]]:
                    around.userdata[around._items_label] = item
                    break
