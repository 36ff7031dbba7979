"""Actions that are Python functions: how they are written, found and called, without ROS.

An action is what a robot does in an action place: a plain function, or a class with callable
instances. The names of its parameters, all of them optional, declare what it needs; any other
parameter is a setting, whose value the plan gives to the function, or to the ``__init__`` of the
class. ``docs/plan_file.md`` lists them. Functions written for the thesis take ``id``.

An action returns the name of the transition to fire, or None, "" or "None" to let the policy decide
(thesis Algorithm 1). It may also return a pair that includes data by name for other actions to
read: ``"T_seen", {"task.pose": [1, 2]}`` (see :mod:`gspn_framework_package.model.data`). Any
exception means that the action failed; :class:`ActionFailed` reports the failure without logging a
traceback. A class is instantiated once for each robot (its ``__init__`` may ask for ``robot``) and
for each different choice of settings. For example, this is ``actions.py`` in a plan's folder; the
plan refers to the function as ``actions.count``::

    from gspn_framework_package.execution.actions import action

    @action
    def count(place, feedback, is_cancelled):
        for second in range(10):
            feedback(second)
            if is_cancelled.wait(1.0):
                return None
        return "T_counted"

The decorator is optional; it checks the parameters of a function without settings when its module
is imported.
"""

from __future__ import annotations

import copy
import inspect
import json
import re
import threading
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    ClassVar,
    Dict,
    FrozenSet,
    Iterable,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Set,
    Tuple,
    Type,
    TypeVar,
    Union,
)

from gspn_framework_package.execution.plan_modules import load_module, refuse_foreign_function
from gspn_framework_package.model.action import FunctionAction
from gspn_framework_package.model.data import check_values
from gspn_framework_package.model.errors import PlanError
from gspn_framework_package.model.expression import shorten
from gspn_framework_package.model.plan import Plan

if TYPE_CHECKING:
    from gspn_framework_package.execution.firing import StartAction

_Function = TypeVar("_Function", bound=Callable[..., Any])


class ActionFailed(Exception):  # noqa: N818  # a failed action, not an error of the program
    """Raised by an action that does not succeed; the operator sees its text."""


TEXT_LIMIT = 500
"""Maximum length of the text of an action's failure or result; longer texts are truncated."""


def error_text(error: BaseException) -> str:
    """The text of a user's exception, on one line of at most :data:`TEXT_LIMIT` characters; also
    handles exceptions that cannot be converted to text."""
    try:
        return shorten(str(error), TEXT_LIMIT)
    except Exception as another:
        return "(its text cannot be shown: %s)" % type(another).__name__


class Cancellation:
    """Lets an action check whether it should end."""

    def __init__(self) -> None:
        self._event = threading.Event()
        self._lock = threading.Lock()
        self._called: List[Callable[[], None]] = []

    def __call__(self) -> bool:
        """Whether the action should end."""
        return self._event.is_set()

    def wait(self, seconds: Optional[float] = None) -> bool:
        """Sleep for ``seconds`` (None: without limit), or until the action should end; returns
        whether it should."""
        return self._event.wait(seconds)

    def cancel(self) -> None:
        """Ask the action to end."""
        with self._lock:
            self._event.set()
            called, self._called = self._called, []
        for function in called:
            function()

    def on_cancel(self, function: Callable[[], None]) -> None:
        """Call ``function`` as soon as the action should end, on the thread that cancels it."""
        with self._lock:
            if not self._event.is_set():
                self._called.append(function)
                return
        function()


def no_feedback(*progress: Any) -> None:
    """A ``feedback`` that discards the progress."""


class ActionContext(NamedTuple):
    """The values that an action may ask for by parameter name."""

    place: str
    robot: str
    feedback: Callable[..., None]
    is_cancelled: Cancellation
    visit: int = 0
    attempt: int = 1
    data: Mapping[str, Any] = {}
    resumed_from: int = 0

    @classmethod
    def of(
        cls, command: StartAction, feedback: Callable[..., None], is_cancelled: Cancellation
    ) -> ActionContext:
        """The values for an action that a command starts."""
        return cls(
            command.place,
            command.robot,
            feedback,
            is_cancelled,
            command.visit,
            command.attempt,
            command.data,
            command.resumed_from,
        )

    @property
    def id(self) -> Union[int, str]:
        """The number at the end of the robot's name, or the name itself if there is none."""
        number = re.search(r"[0-9]{1,18}$", self.robot)
        return int(number.group()) if number else self.robot


class ActionResult(NamedTuple):
    """The result of an action: the ``transition`` that it names ("" to let the policy decide), and
    the ``data`` that it wrote."""

    transition: str
    data: Mapping[str, Any]


ACTION_PARAMETERS = ActionContext._fields + ("id",)
"""The parameter names by which an action may ask for values."""


NO_SETTINGS: Mapping[str, Any] = {}


class PythonFunction:
    """A function or class of a plan, ready to be called for any robot.

    :param function: the function, or the class.
    :param name: its name in the plan, for messages.
    :param settings: the settings in the plan, by parameter name.
    :raises PlanError: it cannot be called, has a parameter that is neither known nor a setting, or
        lacks a parameter for a setting.
    """

    known: ClassVar[Tuple[str, ...]] = ()
    """The parameter names by which the function may ask for values."""
    role: ClassVar[str] = "function"
    """The name of this kind of function in error messages."""

    def __init__(
        self, function: Callable[..., Any], name: str, settings: Mapping[str, Any] = NO_SETTINGS
    ) -> None:
        self.name = name
        self._settings = settings
        element = "%s '%s'" % (self.role, name)
        self._class = function if inspect.isclass(function) else None
        self._names: FrozenSet[str]
        self._init_names: FrozenSet[str] = frozenset()
        if self._class is None:
            self._function = function
            self._names = self._parameters(function, element, settings)
        else:
            call = inspect.getattr_static(self._class, "__call__", None)
            if not inspect.isfunction(call):
                raise PlanError(
                    "the class has no method __call__",
                    element=element,
                    hint="an %s is a function, or a class whose objects can be called" % self.role,
                )
            self._names = self._parameters(call, element, bound=True)
            if self._class.__init__ is not object.__init__:
                self._init_names = self._parameters(
                    self._class.__init__, element, settings, bound=True
                )
            else:
                self.asked_of([], element, settings)
            self._objects: Dict[str, Any] = {}
            self._lock = threading.Lock()

    def asks_for(self, name: str) -> bool:
        """Whether the function (or ``__call__`` of the class) has this parameter."""
        return name in self._names

    def call(self, context: Any) -> Any:
        """Call the function and return its result. Its exceptions propagate.

        :param context: has an attribute for each name in :attr:`known`, and ``robot``.
        """
        if self._class is None:
            return self._function(**_pick(context, self._names), **self._settings)
        return self._object(context)(**_pick(context, self._names))

    def _object(self, context: Any) -> Any:
        assert self._class is not None
        with self._lock:
            if context.robot not in self._objects:
                self._objects[context.robot] = self._class(
                    **_pick(context, self._init_names), **self._settings
                )
            return self._objects[context.robot]

    def _parameters(
        self,
        function: Callable[..., Any],
        element: str,
        settings: Mapping[str, Any] = NO_SETTINGS,
        bound: bool = False,
    ) -> FrozenSet[str]:
        """The :attr:`known` parameters that ``function`` asks for, apart from its settings."""
        try:
            parameters = list(inspect.signature(function).parameters.values())[1 if bound else 0 :]
        except (TypeError, ValueError):  # built-in functions may lack a signature
            parameters = []
        return self.asked_of(parameters, element, settings)

    @classmethod
    def asked_of(
        cls,
        parameters: Iterable[inspect.Parameter],
        element: str,
        settings: Mapping[str, Any] = NO_SETTINGS,
    ) -> FrozenSet[str]:
        """The :attr:`known` names among the parameters of a function, apart from its settings.

        :raises PlanError: a parameter is neither known nor a setting, a setting has no parameter or
            the name of a known one, or its value does not fit the default or the annotation of the
            parameter.
        """
        reserved = sorted(set(settings).intersection(cls.known))
        if reserved:
            raise PlanError(
                "the setting '%s' has a reserved name" % reserved[0],
                element=element,
                hint="rename it; reserved names: %s" % ", ".join(cls.known),
            )
        names: Set[str] = set()
        unused = set(settings)
        missing = inspect.Parameter.empty
        for parameter in parameters:
            if parameter.kind is parameter.VAR_KEYWORD:
                names.update(cls.known)
                unused.clear()
            elif parameter.name in unused and parameter.kind is not parameter.POSITIONAL_ONLY:
                unused.remove(parameter.name)
                wanted = _not_fitting(settings[parameter.name], parameter)
                if wanted:
                    raise PlanError(
                        "its setting '%s' takes %s, not %s"
                        % (parameter.name, wanted, json.dumps(settings[parameter.name])[:80]),
                        element=element,
                    )
            elif parameter.name in cls.known:
                if parameter.kind is parameter.POSITIONAL_ONLY:
                    raise PlanError(
                        "its parameter '%s' cannot be passed by name" % parameter.name,
                        element=element,
                    )
                names.add(parameter.name)
            elif parameter.kind is not parameter.VAR_POSITIONAL and parameter.default is missing:
                raise PlanError(
                    "its parameter '%s' is not one that an %s can ask for, and has no value"
                    % (parameter.name, cls.role),
                    element=element,
                    hint="known parameters: %s; give a value for any other in the plan, under "
                    "settings" % ", ".join(cls.known),
                )
        if unused:
            raise _no_parameter(element, unused)
        return frozenset(names)


_JSON_KINDS: Dict[type, Tuple[str, Tuple[type, ...]]] = {
    bool: ("true or false", (bool, int)),
    int: ("a number", (int, float)),
    float: ("a number", (int, float)),
    str: ("a text", (str,)),
    list: ("a list", (list,)),
    tuple: ("a list", (list,)),
    dict: ("an object", (dict,)),
}
"""Type of a parameter -> its description for people, and the types of its values in JSON."""


def _not_fitting(value: Any, parameter: inspect.Parameter) -> str:
    """Describe what a parameter takes if a value from a plan certainly does not fit; otherwise
    ""."""
    annotation: Any = parameter.annotation
    if isinstance(annotation, str):  # a string under "from __future__ import annotations"
        annotation = {kind.__name__: kind for kind in _JSON_KINDS}.get(annotation)
    for kind in (annotation, type(parameter.default)):
        known = isinstance(kind, type) and kind in _JSON_KINDS
        if known and not isinstance(value, _JSON_KINDS[kind][1]):
            # a default of None or "" often stands for a value of another type
            if kind is str and annotation is not str:
                continue
            return _JSON_KINDS[kind][0]
    return ""


class PythonAction(PythonFunction):
    """An action of a plan that is a function or class."""

    known = ACTION_PARAMETERS
    role = "action"

    def __call__(self, context: ActionContext) -> ActionResult:
        """Run the action.

        :raises DataError: the action returned data that cannot be stored.

        Its exceptions propagate. A transition that is not a string is returned as its ``repr`` (at
        most 200 characters), which the token game reports as a bad result since it names no
        transition.
        """
        if context.data:  # an action must not change the values for others
            context = context._replace(data=copy.deepcopy(dict(context.data)))
        return read_result(self.call(context))


def read_result(returned: Any) -> ActionResult:
    """Parse an action's return value: a transition, nothing, or a pair with data.

    :raises DataError: the data cannot be stored.
    """
    data: Mapping[str, Any] = NO_SETTINGS
    if isinstance(returned, tuple) and len(returned) == 2 and isinstance(returned[1], dict):
        returned, data = returned[0], check_values(returned[1])
    if returned is None:
        return ActionResult("", data)
    return ActionResult(returned if isinstance(returned, str) else "%.200r" % (returned,), data)


_Kind = TypeVar("_Kind", bound=PythonFunction)


def action(function: _Function) -> _Function:
    """Decorator that marks a function (or class) as an action and checks its parameters at once.

    :raises PlanError: the function has a required parameter that is not one of
        :data:`ACTION_PARAMETERS`.
    """
    PythonAction(function, getattr(function, "__qualname__", repr(function)))
    return function


def split_function(name: str) -> Tuple[str, str]:
    """Split a function's name in a plan into its folder, relative to the plan's folder ("" for that
    folder itself), and ``module.function``; for example ``parts/actions.approach``."""
    within, _, function = name.rpartition("/")
    return within, function


def load_action(
    folder: Optional[str], name: str, settings: Mapping[str, Any] = NO_SETTINGS
) -> PythonAction:
    """Load the action ``module.function`` of a plan.

    :raises PlanError: see :func:`load_function`.
    """
    return load_function(folder, name, settings, PythonAction)


def load_function(
    folder: Optional[str], name: str, settings: Mapping[str, Any], kind: Type[_Kind]
) -> _Kind:
    """Load ``module.function`` of a plan.

    :param folder: the plan's folder, which is searched for ``module.py`` (its subfolder for
        ``package.module``); other modules are imported normally, if the user allowed them (see
        :mod:`gspn_framework_package.execution.plan_modules`).
    :param name: ``module.function``, or ``folder/module.function`` (see :func:`split_function`).
    :param settings: the settings in the plan, by parameter name.
    :param kind: what the function is for.
    :raises PlanError: the module or function does not exist, importing the module failed, or the
        function is not of that kind.
    """
    element = "%s '%s'" % (kind.role, name)
    within, name = split_function(name)
    module_name, dot, function_name = name.rpartition(".")
    if not dot or not module_name or not all(part.isidentifier() for part in name.split(".")):
        raise PlanError(
            "'%s' is not a valid function name" % name,
            element=element,
            hint="write module.function",
        )
    module = load_module(folder, within, module_name, element)
    function = getattr(module, function_name, None)
    if function is None:
        there = sorted(
            key
            for key, value in vars(module).items()
            if callable(value) and getattr(value, "__module__", "") == module.__name__
        )
        raise PlanError(
            "the module has no '%s'" % function_name,
            file=module.__file__,
            element=element,
            hint="functions of the module: %s" % ", ".join(there)
            if there
            else "the module has no functions",
        )
    if not callable(function):
        raise PlanError(
            "the name does not refer to a function", file=module.__file__, element=element
        )
    try:
        refuse_foreign_function(function, name, folder)
    except PlanError as error:
        raise error.located(file=module.__file__, element=element) from None
    try:
        return kind(function, name, settings)
    except PlanError as error:
        raise error.located(file=module.__file__) from None


def load_actions(plan: Plan, robot: str) -> Dict[str, PythonAction]:
    """Load the Python actions of a robot, by place. Places with other actions, or none, are left
    out.

    :raises PlanError: see :func:`load_action`.
    """
    loaded: Dict[str, PythonAction] = {}
    result = {}
    for place in plan.action_places:
        bound = plan.action(robot, place)
        if isinstance(bound, FunctionAction):
            key = bound.function + json.dumps(bound.settings, sort_keys=True)
            if key not in loaded:
                loaded[key] = load_action(plan.folder, bound.function, bound.settings)
            result[place] = loaded[key]
    return result


def _no_parameter(element: str, settings: Iterable[str]) -> PlanError:
    return PlanError(
        "the function has no parameter for the setting '%s'" % sorted(settings)[0],
        element=element,
        hint="settings are passed by name to the function, or to __init__ of the class",
    )


def _pick(context: Any, names: FrozenSet[str]) -> Dict[str, Any]:
    return {name: getattr(context, name) for name in names}
