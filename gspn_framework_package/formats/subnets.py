"""Subnets of a plan file: a place whose action is another plan.

The net of the other plan replaces the place when the plan is read, and all settings of the other
plan for its places and transitions come with it, under names prefixed with the place
(``dock.Approach``). So code that runs or analyses a plan need not know about subnets.
"""

from __future__ import annotations

import json
import os
import posixpath
import re
from dataclasses import replace
from typing import (
    Any,
    Callable,
    Collection,
    Dict,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)

from gspn_framework_package.model.action import Action, FunctionAction, outcomes_of, server_name
from gspn_framework_package.model.condition import parse_condition
from gspn_framework_package.model.errors import (
    ExpressionError,
    InputError,
    NetError,
    PlanError,
    RefusedError,
)
from gspn_framework_package.model.event import EventSource, Tasks
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import Plan
from gspn_framework_package.model.policy import Policy, PolicyRow, PolicyScope
from gspn_framework_package.model.subnet import SEPARATOR, Subnet

MOST_NODES_TOGETHER = 100_000
"""Maximum number of nodes of a net with its subnets, since nesting multiplies them."""

_PARAMETER = re.compile(r"\$(\$?)\{([A-Za-z_][A-Za-z0-9_]*)\}")

_PER_PLACE = ("timeout", "on_failure", "durations", "outcomes", "failures")


class SubnetPart(NamedTuple):
    """A subnet being inserted into a plan.

    :ivar name: the place that it replaces.
    :ivar plan: its own plan.
    :ivar entry: the place where robots enter, by its name in the complete net.
    :ivar exit: the place where they leave, likewise.
    :ivar names: node of its own net -> name in the complete net.
    :ivar shared: the resource places that belong to the plan around it, by their names there.
    :ivar folder: the folder of its functions, relative to that of the plan around it.
    """

    name: str
    plan: Plan
    entry: str
    exit: str
    names: Mapping[str, str]
    shared: Collection[str]
    folder: str

    @property
    def robot_places(self) -> List[str]:
        """Its action places, by their names in the complete net."""
        return [self.names[place] for place in self.plan.action_places]


# -- parameters ------------------------------------------------------------------------------------


def fill_parameters(data: Dict[str, Any], given: Optional[Mapping[str, Any]]) -> Dict[str, Any]:
    """Return the JSON object of a plan with its parameters replaced by values, in its actions and
    events: ``${name}``, or ``$${name}`` for the text ``${name}`` itself. A text that consists of a
    single parameter becomes its value, of any type.

    :param data: the object, not yet checked.
    :param given: the values from the plan that uses this one as a subnet; None if it is read
        alone: then its own ``parameters`` are the values, and nothing is replaced if there are
        none.
    :raises PlanError: a parameter has no value, or one is given that does not exist.
    """
    own = data.get("parameters")
    if given is None and own is None:
        return data
    values = {**(own if isinstance(own, Mapping) else {}), **(given or {})}
    used = set(own) if isinstance(own, Mapping) else set()

    def fill(part: Any, element: str) -> Any:
        if isinstance(part, str):
            return text(part, element)
        if isinstance(part, Mapping):
            return {
                str(text(key, element, True)): fill(value, "%s.%s" % (element, key))
                for key, value in part.items()
            }
        if isinstance(part, list):
            return [fill(value, element) for value in part]
        return part

    def text(part: str, element: str, as_text: bool = False) -> Any:
        def value(found: re.Match[str]) -> str:
            if found.group(1):
                return found.group()[1:]
            known = look_up(found.group(2), element)
            return known if isinstance(known, str) else json.dumps(known)

        whole = _PARAMETER.fullmatch(part)
        if whole and not whole.group(1) and not as_text:
            return look_up(whole.group(2), element)
        return _PARAMETER.sub(value, part)

    def look_up(name: str, element: str) -> Any:
        used.add(name)
        if name not in values:
            raise PlanError(
                "the parameter ${%s} has no value" % name,
                element=element,
                hint="give it in 'parameters', or in 'with' where this plan is used as a subnet; "
                "write $${%s} for the text itself" % name,
            )
        return values[name]

    filled = {
        key: {name: fill(value, "%s.%s" % (key, name)) for name, value in part.items()}
        for key, part in data.items()
        if key in ("actions", "events") and isinstance(part, Mapping)
    }
    unknown = sorted(set(given or ()) - used)
    if unknown:
        raise PlanError(
            "it has no parameter '%s'" % unknown[0],
            element="parameters",
            hint="it has: %s" % ", ".join(sorted(used)) if used else "it has none",
        )
    return {**data, **filled}


# -- the net ---------------------------------------------------------------------------------------


def expand(
    data: Dict[str, Any], net: Net, folder: str, read: Callable[[str, Mapping[str, Any]], Plan]
) -> Tuple[Dict[str, Any], Net, List[SubnetPart]]:
    """Replace the places of a plan that stand for other plans.

    :param data: the JSON object of the plan, which fits the schema.
    :param folder: the folder of the plan.
    :param read: reads the plan in a file, given its name and the values of its parameters.
    :returns: the object without these places, the complete net, and the parts for
        :func:`with_parts`.
    :raises GspnError: a subnet cannot be read, or does not fit.
    """
    subnets = {
        place: spec
        for place, spec in data["actions"].items()
        if isinstance(spec, Mapping) and "plan" in spec
    }
    if not subnets:
        return data, net, []
    from gspn_framework_package.model.composition import expand_place

    _refuse_counts(data, net, subnets)
    parts = []
    for place, spec in subnets.items():
        element = "actions.%s" % place
        if place not in net.place_index:
            raise PlanError("the net has no place '%s'" % place, element=element)
        inner = _read(read, spec, element)
        ends = [_end(inner, spec[key], "%s.%s" % (element, key), key) for key in ("entry", "exit")]
        shared = spec.get("share", {})
        _check_shared(data, net, inner, shared, element)
        own_net = inner.net.with_marking(
            {p.name: p.tokens for p in inner.net.places if p.name in inner.resource_places}
        )
        try:
            net = expand_place(
                net, place, own_net, *ends, resources=inner.resource_places, shared=shared
            )
        except NetError as error:
            raise PlanError(
                error.message, element="%s: %s" % (element, error.element), hint=error.hint
            ) from None
        if len(net.places) + len(net.transitions) > MOST_NODES_TOGETHER:
            raise PlanError(
                "the net with its subnets has more than %d nodes" % MOST_NODES_TOGETHER,
                element=element,
            )
        nodes = [p.name for p in inner.net.places] + [t.name for t in inner.net.transitions]
        names = {name: shared.get(name, place + SEPARATOR + name) for name in nodes}
        relative = os.path.relpath(inner.folder or folder, folder).replace(os.sep, "/")
        parts.append(
            SubnetPart(
                place, inner, names[ends[0]], names[ends[1]], names, shared.values(), relative
            )
        )
    return _without_places(data, parts), net, parts


def _read(
    read: Callable[[str, Mapping[str, Any]], Plan], spec: Mapping[str, Any], element: str
) -> Plan:
    try:
        return read(spec["plan"], spec.get("with", {}))
    except (InputError, RefusedError) as error:
        if error.file is None:
            error.located(element=element)
        raise


def _end(plan: Plan, place: str, element: str, key: str) -> str:
    """The place of a plan where robots enter or leave it."""
    if place in plan.subnets:
        subnet = plan.subnets[place]
        place = subnet.entry if key == "entry" else subnet.exit
    if place not in plan.action_places:
        raise PlanError(
            "'%s' is not an action place of %s" % (place, plan.file or plan.name),
            element=element,
            hint="it has: %s" % ", ".join(plan.action_places[:20]),
        )
    return place


def _check_shared(
    data: Mapping[str, Any], net: Net, inner: Plan, shared: Mapping[str, str], element: str
) -> None:
    for name, outer in shared.items():
        if name not in inner.resource_places:
            raise PlanError(
                "'%s' is not a resource place of %s" % (name, inner.file or inner.name),
                element="%s.share" % element,
            )
        if outer not in data.get("resource_places", ()) or outer not in net.place_index:
            raise PlanError(
                "'%s' is not a resource place of this plan" % outer, element="%s.share" % element
            )
    if len(set(shared.values())) < len(shared):
        raise PlanError(
            "two of its resource places cannot be the same place", element="%s.share" % element
        )


def _refuse_counts(data: Mapping[str, Any], net: Net, subnets: Collection[str]) -> None:
    """Refuse references to a subnet as if it were a place."""

    def refuse(place: str, element: str) -> PlanError:
        return PlanError(
            "'%s' is a subnet, not one place" % place,
            element=element,
            hint="name a place of it, as %s%sPLACE" % (place, SEPARATOR),
        )

    for place in subnets:
        for key in _PER_PLACE:
            if place in data.get(key, {}):
                raise refuse(place, "%s.%s" % (key, place))
        if place in data.get("resource_places", ()):
            raise PlanError("a resource place cannot be a subnet", element="actions.%s" % place)
    robots = data.get("robots")
    for robot in robots if isinstance(robots, list) else ():
        for place in set(robot.get("actions", ())).intersection(subnets):
            raise refuse(place, "robots")
    if "until" in data:
        try:
            read = parse_condition(data["until"], net.place_index).places
        except ExpressionError:
            return  # it may refer to places in a subnet; reported later, when all are known
        for place in set(read).intersection(subnets):
            raise refuse(place, "until")


def _without_places(data: Mapping[str, Any], parts: Sequence[SubnetPart]) -> Dict[str, Any]:
    """The object of a plan without the replaced places; where robots start, decide or are sent,
    they are replaced by the entry or exit."""
    entry = {part.name: part.entry for part in parts}
    exit = {part.name: part.exit for part in parts}
    found = dict(data)
    found["actions"] = {p: a for p, a in data["actions"].items() if p not in entry}
    robots = data.get("robots")
    if isinstance(robots, Mapping):
        found["robots"] = {name: entry.get(place, place) for name, place in robots.items()}
    elif robots is not None:
        found["robots"] = [{**r, "place": entry.get(r["place"], r["place"])} for r in robots]
    if "spawn" in data:
        found["spawn"] = [entry.get(place, place) for place in data["spawn"]]
    if "chance" in data:
        found["chance"] = [exit.get(place, place) for place in data["chance"]]
    if "routing" in data:
        found["routing"] = {
            transition: {exit.get(a, a): entry.get(b, b) for a, b in routes.items()}
            for transition, routes in data["routing"].items()
        }
    if "on_evict" in data:
        inside = {part.name: part.robot_places for part in parts}
        returned: Dict[str, Dict[str, int]] = {}
        for place, resources in data["on_evict"].items():
            for each in inside.get(place, [place]):
                returned[each] = _sum(returned.get(each, {}), resources)
        found["on_evict"] = returned
    return found


def _sum(some: Mapping[str, int], more: Mapping[str, int]) -> Dict[str, int]:
    return {name: some.get(name, 0) + more.get(name, 0) for name in {**some, **more}}


# -- other settings --------------------------------------------------------------------------------


def with_parts(plan: Plan, parts: Sequence[SubnetPart]) -> Plan:
    """Return a plan with the settings of its subnets for their places and transitions. A setting of
    the plan itself for one of them (``"timeout": {"dock.Approach": 9}``) takes precedence.

    :param plan: the plan, whose net already includes the subnets.
    :raises PlanError: its policy refers to a subnet as if it were a place, or decides inside one.
    """
    if not parts:
        return plan
    plan = replace(plan, subnets={n: s for part in parts for n, s in _subnets(plan.net, part)})
    plan = replace(plan, policy=_policy(plan, parts))
    for part in parts:
        plan = _with(plan, part)
    return plan


def _with(plan: Plan, part: SubnetPart) -> Plan:
    inner, names = part.plan, part.names

    def renamed(entries: Mapping[str, Any]) -> Dict[str, Any]:
        return {names[name]: value for name, value in entries.items()}

    def by_place(entries: Mapping[str, Any]) -> Dict[str, Any]:
        """Settings of places, where ``'*'`` stands for every other action place of the subnet."""
        every = dict.fromkeys(inner.action_places, entries["*"]) if "*" in entries else {}
        return renamed({**every, **{p: v for p, v in entries.items() if p != "*"}})

    on_evict = {
        names[place]: {names[resource]: count for resource, count in returned.items()}
        for place, returned in inner.on_evict.items()
    }
    return replace(
        plan,
        actions={
            **{names[p]: _action(action, part) for p, action in inner.actions.items()},
            **plan.actions,
        },
        resource_places=plan.resource_places | {names[p] for p in inner.resource_places},
        on_failure={
            **{
                place: rule._replace(transition=names.get(rule.transition, rule.transition))
                for place, rule in by_place(inner.on_failure).items()
            },
            **plan.on_failure,
        },
        timeouts={**by_place(inner.timeouts), **plan.timeouts},
        routing={
            **{
                names[t]: {names[a]: names[b] for a, b in routes.items()}
                for t, routes in inner.routing.items()
            },
            **plan.routing,
        },
        on_evict={
            place: _sum(on_evict.get(place, {}), plan.on_evict.get(place, {}))
            for place in {**on_evict, **plan.on_evict}
        },
        durations={**renamed(inner.durations), **plan.durations},
        outcomes={
            **{
                names[place]: {names.get(t, t): chance for t, chance in chances.items()}
                for place, chances in inner.outcomes.items()
            },
            **plan.outcomes,
        },
        failures={**renamed(inner.failures), **plan.failures},
        chance=plan.chance | {names[place] for place in inner.chance},
        rates={**renamed(inner.rates), **plan.rates},
        own_rates={**plan.own_rates, **renamed(inner.own_rates)},
        evidence={
            **{(key, names[name]): value for (key, name), value in inner.evidence.items()},
            **plan.evidence,
        },
        events={
            **{names[t]: _event(event, part) for t, event in inner.events.items()},
            **plan.events,
        },
        tasks=Tasks(
            _joined(plan.tasks.queues, [names[place] for place in inner.tasks.queues]),
            _joined(plan.tasks.done, [names[t] for t in inner.tasks.done]),
            {
                **{
                    names[place]: None if t is None else names[t]
                    for place, t in inner.tasks.on_cancel.items()
                },
                **plan.tasks.on_cancel,
            },
            {
                **{names[place]: order for place, order in inner.tasks.order.items()},
                **plan.tasks.order,
            },
        ),
        groups={**_groups(part), **plan.groups},
        notes=plan.notes + tuple("%s: %s" % (part.name, note) for note in inner.notes),
    )


def _joined(some: Sequence[str], more: Sequence[str]) -> Tuple[str, ...]:
    return tuple(dict.fromkeys((*some, *more)))


def _action(action: Action, part: SubnetPart) -> Action:
    if isinstance(action, FunctionAction):
        return action._replace(
            function=_function(action.function, part),
            server=server_name(part.name + SEPARATOR + action.server),
        )
    outcomes = {end: part.names.get(t, t) for end, t in outcomes_of(action).items()}
    renamed: Any = action
    return renamed._replace(outcomes=outcomes) if outcomes else action


def _event(event: EventSource, part: SubnetPart) -> EventSource:
    return event._replace(function=_function(event.function, part)) if event.function else event


def _function(function: str, part: SubnetPart) -> str:
    """The name of a function, with the folder of its subnet if that differs."""
    if part.folder == ".":
        return function
    return posixpath.normpath(posixpath.join(part.folder, function))


def _groups(part: SubnetPart) -> Dict[str, Tuple[str, ...]]:
    """The groups of a subnet, without the places that belong to the plan around it."""
    names = {n: part.name + SEPARATOR + n for n in part.plan.subnets}
    names.update(part.names)
    found = {
        part.name + SEPARATOR + title: tuple(
            names[node] for node in nodes if names[node] not in part.shared
        )
        for title, nodes in part.plan.groups.items()
    }
    return {title: nodes for title, nodes in found.items() if nodes}


def _subnets(net: Net, part: SubnetPart) -> List[Tuple[str, Subnet]]:
    """The subnets that a part adds: itself, and those inside it."""
    inner, names = part.plan, part.names
    places = set(names.values()).difference(part.shared)
    found = [
        (
            part.name,
            Subnet(
                inner.name,
                part.entry,
                part.exit,
                tuple(p.name for p in net.places if p.name in places),
                tuple(names[t.name] for t in inner.net.transitions),
            ),
        )
    ]
    for name, subnet in inner.subnets.items():
        found.append(
            (
                part.name + SEPARATOR + name,
                subnet._replace(
                    entry=names[subnet.entry],
                    exit=names[subnet.exit],
                    places=tuple(names[p] for p in subnet.places if names[p] in places),
                    transitions=tuple(names[t] for t in subnet.transitions),
                    parent=SEPARATOR.join(filter(None, (part.name, subnet.parent))),
                ),
            )
        )
    return found


def _policy(plan: Plan, parts: Sequence[SubnetPart]) -> Policy:
    """The policy of a plan combined with those of its subnets, each of which decides for its own
    places."""
    outer = plan.policy
    for part in parts:
        if part.name in outer.places:
            raise PlanError(
                "'%s' is a subnet, not one place" % part.name,
                element="the policy's tuple of places",
                hint="name a place of it, as %s%sPLACE, or a resource place that counts the robots"
                % (part.name, SEPARATOR),
            )
    if outer.scopes:
        raise PlanError(
            "a plan that has subnets gets its scopes from them", element="policy.scopes"
        )
    _refuse_rows(plan, parts)
    if not outer.rows and not any(part.plan.policy.rows for part in parts):
        return outer
    columns = list(outer.places)
    for part in parts:
        columns += [part.names[p] for p in part.plan.policy.places]
    columns = list(dict.fromkeys(columns))
    rows = [_row(row, outer.places, {}, columns) for row in outer.rows]
    scopes: List[PolicyScope] = []
    for part in parts:
        policy, names = part.plan.policy, part.names
        renamed = [
            _row(row, [names[p] for p in policy.places], names, columns) for row in policy.rows
        ]
        own = [renamed[n] for n in policy.bind(part.plan.net).in_scope(0)]
        _add_scope(scopes, rows, [names[p] for p in part.plan.decided_in("")], part, own)
        for inside in part.plan.subnets:
            places = part.plan.decided_in(inside)
            known = next((s for s in policy.scopes if set(s.places) == set(places)), None)
            its = renamed[known.first : known.last] if known is not None else []
            _add_scope(scopes, rows, [names[p] for p in places], part, its)
    return Policy(columns, rows, scopes)


def _add_scope(
    scopes: List[PolicyScope],
    rows: List[PolicyRow],
    places: Sequence[str],
    part: SubnetPart,
    new: Sequence[PolicyRow],
) -> None:
    places = [place for place in places if place != part.exit]
    if places:
        scopes.append(PolicyScope(tuple(places), len(rows), len(rows) + len(new)))
        rows += new


def _row(
    row: PolicyRow, places: Sequence[str], names: Mapping[str, str], columns: Sequence[str]
) -> PolicyRow:
    cells = dict(zip(places, row.counts))
    return PolicyRow(
        tuple(cells.get(place) for place in columns),
        tuple((names.get(t, t), chance) for t, chance in row.choices),
    )


def _refuse_rows(plan: Plan, parts: Sequence[SubnetPart]) -> None:
    """Refuse rows that decide for places that belong to another policy."""
    inside: Dict[
        str, Tuple[SubnetPart, bool]
    ] = {}  # transition -> its subnet, whether it leaves the exit
    for part in parts:
        robots = set(part.robot_places)
        for t, inputs in zip(part.plan.net.transitions, part.plan.net.inputs):
            taken = robots.intersection(part.names[part.plan.net.places[p].name] for p, _ in inputs)
            inside[part.names[t.name]] = part, taken == {part.exit}
    for number, row in enumerate(plan.policy.rows, 1):
        for name, chance in row.choices:
            if chance > 0 and name in inside and not inside[name][1]:
                part = inside[name][0]
                raise PlanError(
                    "'%s' is inside the subnet '%s', where its own policy decides"
                    % (name, part.name),
                    element="policy row %d" % number,
                    hint="put the row into %s" % (part.plan.file or part.plan.name),
                )
    for part in parts:
        for number, row in enumerate(part.plan.policy.rows, 1):
            for name, chance in row.choices:
                if chance > 0 and inside[part.names[name]][1]:
                    raise PlanError(
                        "'%s' leaves the exit of the subnet '%s'" % (name, part.name),
                        file=part.plan.file,
                        element="policy row %d" % number,
                        hint="the policy of the plan around it decides there",
                    )
