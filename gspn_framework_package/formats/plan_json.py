"""Conversion between the model of a plan and a JSON object that fits ``plan.schema.json``."""

from __future__ import annotations

import json
import os
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple, Union

import jsonschema

from gspn_framework_package.formats.json_file import JsonDocument
from gspn_framework_package.formats.net_json import net_from_json, net_to_json
from gspn_framework_package.formats.subnets import SubnetPart, with_parts
from gspn_framework_package.model.action import ACTION_KINDS, action_from_json, action_to_json
from gspn_framework_package.model.condition import parse_condition
from gspn_framework_package.model.duration import FAMILIES, Duration, Evidence
from gspn_framework_package.model.errors import ExpressionError, PlanError
from gspn_framework_package.model.event import SOURCE_KINDS, EventSource, Tasks
from gspn_framework_package.model.failure import (
    FAILURE_KINDS,
    failure_rule_from_json,
    failure_rule_to_json,
)
from gspn_framework_package.model.net import Net
from gspn_framework_package.model.plan import (
    MAX_ROBOTS,
    TIME_KEYS,
    LostKind,
    LostRule,
    OwnTimes,
    Plan,
    RobotSpec,
    Synchronisation,
    Timing,
    Transport,
    too_many_robots,
)
from gspn_framework_package.model.policy import Policy, PolicyScope
from gspn_framework_package.model.policy_cell import written_cell
from gspn_framework_package.model.subnet import Subnet

SCHEMA_FILE = os.path.join(os.path.dirname(__file__), "plan.schema.json")
"""The JSON Schema of plans."""


def schema() -> Dict[str, Any]:
    """Return the JSON Schema of plans (draft 7), which ships with the package, with the forms of
    what other packages have added."""
    with open(SCHEMA_FILE, encoding="utf-8") as file:
        loaded: Dict[str, Any] = json.load(file)
    rules = loaded["properties"]["on_failure"]["additionalProperties"]["oneOf"]
    rules += [kind.form for kind in FAILURE_KINDS.values() if kind.form is not None]
    duration = loaded["definitions"]["duration"]
    for name, family in FAMILIES.items():
        duration["properties"]["distribution"]["enum"].append(name)
        duration["properties"].update(family.form)
        duration["parameters"][name] = list(family.form)
    event = loaded["properties"]["events"]["additionalProperties"]
    for name, source in SOURCE_KINDS.items():
        event["properties"][name] = source.form
        event["allOf"] += [
            {"not": {"required": [name, other]}} for other in ("topic", "function", "after")
        ]
    actions = loaded["definitions"]["action"]["oneOf"]
    actions += [kind.FORM for kind in ACTION_KINDS.values() if hasattr(kind, "FORM")]
    return loaded


def check_schema(
    data: Any,
    definition: Optional[str] = None,
    file: Optional[str] = None,
    document: Optional[JsonDocument] = None,
) -> None:
    """Check ``data`` against the schema of plans, or against one of its definitions.

    :param document: the document with ``data``, to report the line of an element that does not fit.
    :raises PlanError: an element does not fit; the error has its path.
    """
    whole = schema()
    part = whole
    if definition is not None:
        part = dict(whole["definitions"][definition], definitions=whole["definitions"])
    errors = list(jsonschema.Draft7Validator(part).iter_errors(_without_rows(data)))
    if errors:
        from gspn_framework_package.formats.schema_words import SchemaWords, unknown_key

        words = SchemaWords(whole["definitions"])
        error = words.most_telling(errors)
        path = list(error.absolute_path)
        line = document.line(path + unknown_key(error)) if document is not None else None
        element = ".".join(str(step) for step in path)
        message, hint = words.message(error)
        raise PlanError(message, file=file, line=line, element=element or None, hint=hint)


def _without_rows(data: Any) -> Any:
    """A plan or policy without the rows of its policy if they fit the schema: jsonschema would take
    half a minute for tens of thousands of rows."""
    if not isinstance(data, dict):
        return data
    if isinstance(data.get("policy"), dict):
        return {**data, "policy": _without_rows(data["policy"])}
    rows = data.get("rows")
    if isinstance(rows, list) and all(map(_is_row, rows)):
        return {**data, "rows": []}
    return data


_ROW_KEYS = {"marking", "choose"}
_CELLS = {int, str}
_PROBABILITIES = {int, float, str}


def _is_row(row: Any) -> bool:
    """Whether this certainly is a row of a policy as in the schema."""
    return (
        type(row) is dict
        and row.keys() == _ROW_KEYS
        and type(row["marking"]) is list
        and _CELLS.issuperset(map(type, row["marking"]))
        and type(row["choose"]) is dict
        and _PROBABILITIES.issuperset(map(type, row["choose"].values()))
    )


def plan_from_json(
    data: Dict[str, Any],
    net: Optional[Net] = None,
    policy: Optional[Policy] = None,
    *,
    file: Optional[str] = None,
    folder: Optional[str] = None,
    checked: bool = False,
    parts: Sequence[SubnetPart] = (),
) -> Plan:
    """Return the plan of a JSON object.

    :param data: the object; it is checked against the schema.
    :param net: the net, if ``data`` only names its file.
    :param policy: the policy, if ``data`` only names its file.
    :param file: the file that it comes from, for messages and for ``Plan.file``.
    :param folder: the folder with the functions.
    :param checked: whether ``data`` is known to fit the schema.
    :param parts: the subnets, already included in ``data`` and ``net`` (see ``formats.subnets``).
    :raises PlanError: the object does not fit the schema, or names something that does not exist.
    """
    if not checked:
        check_schema(data, file=file)
    if net is None:
        net = net_from_json(data["net"])
    if policy is None:
        policy = policy_from_json(data["policy"]) if "policy" in data else Policy()
    agreement = data.get("agreement", {})
    resources = frozenset(data.get("resource_places", ()))
    robots = _robots(data.get("robots"), file)
    inner = {part.names[p] for part in parts for p in part.plan.resource_places}
    until = data.get("until")
    if until is not None:
        try:
            parse_condition(until, net.place_index)
        except ExpressionError as error:
            raise PlanError(str(error), file=file, element="until") from None
    plan = Plan(
        net=net,
        name=data.get("plan", net.name or "plan"),
        policy=policy,
        actions={p: action_from_json(p, a) for p, a in data["actions"].items()},
        resource_places=resources,
        robots=robots if robots is not None else deal_robots(net, resources | inner),
        spawn=tuple(data.get("spawn", ())),
        synchronisation=Synchronisation(data.get("synchronisation", "full")),
        transport=Transport(data.get("transport", "ros")),
        seed=data.get("seed", 0),
        strict=data.get("strict", False),
        on_failure={p: failure_rule_from_json(r) for p, r in data.get("on_failure", {}).items()},
        timeouts={p: float(s) for p, s in data.get("timeout", {}).items()},
        routing=data.get("routing", {}),
        simulate_environment=data.get("environment", "operator") == "simulate",
        on_lost=_lost_rule(data.get("on_lost", "hold")),
        on_evict=data.get("on_evict", {}),
        until=until,
        **_times(data),
        own_times=_own_times(data.get("own_times", {}), robots, file),
        chance=frozenset(data.get("chance", ())),
        evidence=_evidence(data, (*TIME_KEYS, "rates")),
        events={t: EventSource.from_json(e) for t, e in data.get("events", {}).items()},
        tasks=Tasks.from_json(data.get("tasks", {})),
        subnets={name: Subnet.from_json(s) for name, s in data.get("subnets", {}).items()},
        groups={name: tuple(nodes) for name, nodes in data.get("groups", {}).items()},
        cancel_grace=float(data.get("cancel_grace", Plan.cancel_grace)),
        timing=Timing(
            float(agreement.get("evict_after", Timing().evict_after)),
            float(agreement.get("fence_after", Timing().fence_after)),
        ),
        fsync=agreement.get("fsync", False),
        witness=tuple(agreement.get("witnesses", ())),
        folder=folder,
        file=file,
    )
    # an unknown or immediate transition is left to Plan.validate
    rates = {t: float(r["rate"]) for t, r in data.get("rates", {}).items()}
    return with_parts(plan.with_rates(rates), parts).validate()


LEARNED = (*TIME_KEYS, "rates", "own_times")
"""The keys whose entries may say in ``of`` what they were learned from."""


def _times(data: Dict[str, Any], within: str = "") -> Dict[str, Any]:
    """The durations, outcomes and failures of a plan, or of one robot of it."""
    return {
        "durations": {
            p: _duration("%sdurations.%s" % (within, p), d)
            for p, d in data.get("durations", {}).items()
        },
        "outcomes": {p: o["probabilities"] for p, o in data.get("outcomes", {}).items()},
        "failures": {p: f["probability"] for p, f in data.get("failures", {}).items()},
    }


def _own_times(data: Dict[str, Any], robots: Any, file: Optional[str]) -> Dict[str, OwnTimes]:
    found = {}
    known = None if robots is None else {robot.name for robot in robots}
    for robot, own in data.items():
        within = "own_times.%s" % robot
        if known is not None and robot not in known:
            raise PlanError(
                "the plan has no robot '%s'" % robot,
                file=file,
                element=within,
                hint="there are: %s" % ", ".join(sorted(known)[:12]),
            )
        found[robot] = OwnTimes(**_times(own, within + "."), evidence=_evidence(own, TIME_KEYS))
    return found


def _duration(element: str, data: Dict[str, Any]) -> Duration:
    from gspn_framework_package.model.families import duration_from_json  # not all plans need it

    try:
        return duration_from_json(data)
    except PlanError as error:
        error.element = element
        raise


def _evidence(data: Dict[str, Any], keys: Sequence[str]) -> Dict[Tuple[str, str], Evidence]:
    found = {}
    for key in keys:
        for name, entry in data.get(key, {}).items():
            of = entry.get("of")
            if of is not None:
                interval = of.get("interval")
                found[key, name] = Evidence(
                    of["observations"],
                    tuple(of.get("logs", ())),
                    None if interval is None else (float(interval[0]), float(interval[1])),
                )
    return found


def policy_from_json(data: Dict[str, Any]) -> Policy:
    """Return the policy of a JSON object that fits the schema. :raises PolicyError: see Policy."""
    return Policy.from_table(
        data["places"],
        ((r["marking"], r["choose"]) for r in data["rows"]),
        (PolicyScope(tuple(s["places"]), *s["rows"]) for s in data.get("scopes", ())),
    )


def deal_robots(
    net: Net, resources: Any, order: Optional[List[str]] = None, prefix: str = "robot_"
) -> Any:
    """Create the robots of a plan that names none: one per token of the initial marking, except for
    tokens of resource places. They are numbered place by place: first the places in ``order``, then
    the others in the order of the net.

    :raises PlanError: there are more robots than a team can have.
    """
    places = list(order or ())
    places += [p.name for p in net.places if p.name not in set(places)]
    total = sum(net.place(p).tokens for p in places if p not in resources)
    if total > MAX_ROBOTS:
        raise too_many_robots(total)
    names = [p for p in places if p not in resources for _ in range(net.place(p).tokens)]
    return tuple(RobotSpec("%s%d" % (prefix, k), place) for k, place in enumerate(names, 1))


def _robots(data: Any, file: Optional[str]) -> Any:
    if data is None:
        return None
    if isinstance(data, dict):
        return tuple(RobotSpec(name, place) for name, place in data.items())
    return tuple(
        RobotSpec(
            r["name"],
            r["place"],
            {p: action_from_json(p, a) for p, a in r.get("actions", {}).items()},
            tuple(r.get("capabilities", ())),
        )
        for r in data
    )


def _lost_rule(text: str) -> LostRule:
    kind, _, transition = text.partition(" ")
    return LostRule(LostKind(kind), transition)


# -- writing ---------------------------------------------------------------------------------------


def plan_to_json(plan: Plan) -> Dict[str, Any]:
    """Return the plan as one JSON object with net and policy inline; ``plan_from_json`` makes a
    plan with the same hash from it. The object names the functions but does not contain them."""
    data: Dict[str, Any] = {
        "plan": plan.name,
        "net": net_to_json(plan.file_net),
        "policy": policy_to_json(plan.policy),
        "actions": {p: action_to_json(a) for p, a in plan.actions.items()},
        "resource_places": sorted(plan.resource_places),
        "synchronisation": plan.synchronisation.value,
        "robots": [
            {
                "name": r.name,
                "place": r.place,
                "actions": {p: action_to_json(a) for p, a in r.actions.items()},
                **({"capabilities": list(r.capabilities)} if r.capabilities else {}),
            }
            for r in plan.robots
        ],
        "spawn": list(plan.spawn),
        "seed": plan.seed,
        "strict": plan.strict,
        "on_failure": {p: failure_rule_to_json(r) for p, r in plan.on_failure.items()},
        "timeout": dict(plan.timeouts),
        "routing": {t: dict(r) for t, r in plan.routing.items()},
        "environment": "simulate" if plan.simulate_environment else "operator",
        "on_lost": " ".join(filter(None, (plan.on_lost.kind.value, plan.on_lost.transition))),
        "on_evict": {p: dict(r) for p, r in plan.on_evict.items()},
        "agreement": {
            "evict_after": plan.timing.evict_after,
            "fence_after": plan.timing.fence_after,
            "fsync": plan.fsync,
            "witnesses": list(plan.witness),
        },
    }
    if plan.transport is not Transport.ROS:
        data["transport"] = plan.transport.value
    if plan.until is not None:
        data["until"] = plan.until
    if plan.events:
        data["events"] = {t: event.to_json() for t, event in plan.events.items()}
    if plan.tasks != Tasks():
        data["tasks"] = plan.tasks.to_json()
    if plan.subnets:
        data["subnets"] = {name: subnet.to_json() for name, subnet in plan.subnets.items()}
    if plan.groups:
        data["groups"] = {name: list(nodes) for name, nodes in plan.groups.items()}
    if plan.cancel_grace != Plan.cancel_grace:
        data["cancel_grace"] = plan.cancel_grace
    if plan.chance:
        data["chance"] = sorted(plan.chance)
    data.update(_values_to_json(plan, plan.rates))
    own = {
        robot.name: _values_to_json(plan.own_times[robot.name], {})
        for robot in plan.robots
        if robot.name in plan.own_times
    }
    if own:
        data["own_times"] = own
    return data


def _values_to_json(
    of: Union[Plan, OwnTimes], rates: Mapping[str, float]
) -> Dict[str, Dict[str, Dict[str, Any]]]:
    """The values that may be learned, of a plan or of one robot of it."""
    values: Dict[str, Dict[str, Dict[str, Any]]] = {
        "durations": {p: d.to_json() for p, d in of.durations.items()},
        "outcomes": {p: {"probabilities": dict(o)} for p, o in of.outcomes.items()},
        "failures": {p: {"probability": f} for p, f in of.failures.items()},
        "rates": {t: {"rate": r} for t, r in rates.items()},
    }
    for (key, name), evidence in of.evidence.items():
        values[key][name]["of"] = evidence_to_json(evidence)
    return {key: entries for key, entries in values.items() if entries}


def evidence_to_json(evidence: Evidence) -> Dict[str, Any]:
    """Return the ``of`` of an entry of a plan file."""
    data: Dict[str, Any] = {"observations": evidence.observations}
    if evidence.logs:
        data["logs"] = list(evidence.logs)
    if evidence.interval is not None:
        data["interval"] = list(evidence.interval)
    return data


def policy_to_json(policy: Policy) -> Dict[str, Any]:
    """Return the policy as a JSON object; ``policy_from_json`` reads it."""
    data = {
        "places": list(policy.places),
        "rows": [
            {"marking": [written_cell(cell) for cell in row.counts], "choose": dict(row.choices)}
            for row in policy.rows
        ],
    }
    if policy.scopes:
        data["scopes"] = [
            {"places": list(s.places), "rows": [s.first, s.last]} for s in policy.scopes
        ]
    return data


def plan_to_short_json(plan: Plan) -> Dict[str, Any]:
    """As :func:`plan_to_json`, but without default values, for people to read."""
    data = plan_to_json(plan)
    default = plan_to_json(Plan(plan.net))
    short = {
        key: value
        for key, value in data.items()
        if key in ("net", "actions") or value != default.get(key)
    }
    if plan.robots and not any(r.actions or r.capabilities for r in plan.robots):
        short["robots"] = {robot.name: robot.place for robot in plan.robots}
    return short
