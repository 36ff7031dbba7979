"""Random plans, each with the policy computed for every aim, written and read again: what it is
worth, by dense linear algebra on the markings of the net, is the certified optimum."""

import dataclasses
import json
import math
import random

import numpy as np
import pytest

from gspn_framework_package.analysis.decisions.aims import Aim, Objective, Request
from gspn_framework_package.analysis.decisions.optimise import optimise
from gspn_framework_package.formats.plan_file import plan_document, read_plan
from gspn_framework_package.model.condition import parse_condition
from gspn_framework_package.model.errors import RefusedError


def write_random_plan(folder, rng):
    """A plan with a robot that chooses in ``H*``, works in ``W*``, and takes ``F*``."""
    hubs, works, flags = (
        [letter + str(i) for i in range(n)]
        for letter, n in (
            ("H", rng.randint(1, 3)),
            ("W", rng.randint(2, 4)),
            ("F", rng.choice((0, 1))),
        )
    )
    transitions, arcs = [], []

    def add(source, target, **timing):
        name = "t%d" % len(transitions)
        transitions.append({"name": name, **timing})
        arcs.extend(({"from": source, "to": name}, {"from": name, "to": target}))
        return name

    for hub in hubs:
        for _ in range(rng.randint(1, 3)):
            target = rng.choice(
                works if rng.random() < 0.8 else [h for h in hubs if h != hub] or works
            )
            name = add(hub, target)
            if flags and rng.random() < 0.4:
                arcs.append({"from": flags[0], "to": name, "inhibitor": rng.random() < 0.4})
    for work in works:
        for _ in range(rng.choice((0, 1, 1, 1, 2))):
            target = rng.choice(hubs if rng.random() < 0.6 else hubs + works)
            add(work, target, timed=True, rate=rng.choice((0.5, 1.0, 2.0)))
    for flag in flags:
        transitions.append({"name": "due", "timed": True, "rate": 0.5})
        arcs.append({"from": "due", "to": flag})
        arcs.append({"from": flag, "to": "due", "inhibitor": True})
    rng.shuffle(transitions)
    start = rng.choice(hubs + works)
    places = [{"name": p, "tokens": int(p == start)} for p in hubs + works + flags]
    document = {
        "plan": "random",
        "net": {"places": places, "transitions": transitions, "arcs": arcs},
        "actions": {p: None if p in hubs else "actions.act" for p in hubs + works},
        "robots": {"r": start},
        "resource_places": flags,
        "environment": "simulate",
    }
    (folder / "actions.py").write_text("def act():\n    pass\n")
    (folder / "plan.json").write_text(json.dumps(document))
    return works, [t["name"] for t in transitions]


def objectives(rng, works, names):
    goal = "%s >= 1" % rng.choice(works)
    rewards = {rng.choice(names): 1.0, rng.choice(works): rng.choice((0.0, 0.5))}
    for objective in (
        Objective.reach(goal),
        Objective.time_to(goal),
        Objective.cost_to(goal, {work: float(i % 2) for i, work in enumerate(works)}),
        Objective.long_run(rewards),
        Objective.discounted(rewards, 0.3),
    ):
        yield dataclasses.replace(objective, maximise=True)
        yield dataclasses.replace(objective, maximise=False)


def value(plan, objective):
    """What a plan's policy is worth, in the classical reading."""
    net, table = plan.net, plan.policy.bind(plan.net)
    names = [p.name for p in net.places]
    markings, arcs, index = [tuple(net.initial_marking)], [], {tuple(net.initial_marking): 0}
    for number, marking in enumerate(markings):  # which grows meanwhile
        enabled = [
            t
            for t in range(len(net.transitions))
            if all(marking[p] >= w for p, w in net.inputs[t])
            and all(marking[p] < w for p, w in net.inhibitors[t])
        ]
        drawn = [t for t in enabled if not net.transitions[t].timed]
        chances = {t: net.transitions[t].rate for t in enabled}
        if drawn:
            asking = next(p for t in drawn for p, _ in net.inputs[t] if names[p].startswith("H"))
            told = table.distribution(list(marking), asking)
            choices = dict(told.choices) if told else {t: net.transitions[t].weight for t in drawn}
            chances = {t: v for t, v in choices.items() if t in drawn and v > 0}
        for t, chance in chances.items():
            after = list(marking)
            for p, change in net.effect(t):
                after[p] += change
            target = index.setdefault(tuple(after), len(markings))
            if target == len(markings):
                markings.append(tuple(after))
            arcs.append((number, target, t, chance, not drawn))
    count = len(markings)
    steps, earned, time = np.zeros((count, count)), np.zeros(count), np.ones(count)
    for source, target, t, chance, timed in arcs:
        steps[source, target] += chance
        earned[source] += chance * objective.rewards.get(net.transitions[t].name, 0.0)
        time[source] = float(timed)
    earned += time * (np.array(markings) @ [objective.rewards.get(name, 0.0) for name in names])
    exits = steps.sum(axis=1)
    goal = np.zeros(count, dtype=bool)
    if objective.goal:
        columns = np.array(markings).T
        goal = parse_condition(objective.goal, names).holds_in_columns(columns, count)
    stops = goal | (exits == 0)
    if objective.aim is Aim.DISCOUNTED:
        exits = exits + objective.discount * time
        return np.linalg.solve(np.diag(exits) - steps, earned)[0]
    steps[stops], exits[stops] = 0.0, 1.0
    steps, earned, time = steps / exits[:, None], earned / exits, time / exits
    reaches = np.linalg.matrix_power(np.eye(count) + steps, count) > 0
    if objective.aim is Aim.LONG_RUN:
        total = 0.0
        closed = [i for i in range(count) if reaches[reaches[i], i].all()]
        outside = [i for i in range(count) if i not in closed]
        first = [i for i in closed if i == np.flatnonzero(reaches[i])[0]]
        for i in first:
            states = np.flatnonzero(reaches[i])
            among = steps[np.ix_(states, states)] - np.eye(len(states))
            among[:, 0] = 1.0
            share = np.linalg.solve(among.T, np.eye(len(states))[0]) if len(states) > 1 else [1.0]
            into = np.zeros(count)
            into[states] = 1.0
            inner = np.eye(len(outside)) - steps[np.ix_(outside, outside)]
            into[outside] = np.linalg.solve(inner, (steps @ into)[outside])
            total += into[0] * (share @ earned[states]) / (share @ time[states])
        return total
    coming = reaches[:, goal].any(axis=1)
    inside = np.flatnonzero(coming & ~goal)
    if objective.aim is not Aim.REACH and not coming[reaches[0]].all():
        return math.inf
    gained = {Aim.REACH: steps @ goal, Aim.TIME_TO: time}.get(objective.aim, earned)
    values = goal.astype(float) if objective.aim is Aim.REACH else np.zeros(count)
    inner = np.eye(len(inside)) - steps[np.ix_(inside, inside)]
    values[inside] = np.linalg.solve(inner, gained[inside])
    return values[0]


@pytest.mark.long
@pytest.mark.parametrize("seed", [*range(16), 23, 84, 121])
def test_an_exported_policy_is_worth_the_certified_optimum(tmp_path, seed):
    rng = random.Random(seed)
    works, names = write_random_plan(tmp_path, rng)
    path = str(tmp_path / "plan.json")
    plan = read_plan(path)
    answers = 0
    for objective in objectives(rng, works, names):
        try:
            report = optimise(plan, Request(objective, reading="net"), simulated=0)
        except RefusedError as error:
            assert "infinite" in error.message
            continue
        document = plan_document(path, report.plan, str(tmp_path))
        (tmp_path / "best.json").write_text(json.dumps(document))
        own = report.teams[0]
        found = value(read_plan(str(tmp_path / "best.json")), objective)
        assert found == pytest.approx(own.value, rel=1e-6, abs=1e-9), objective
        assert own.lower - 1e-9 <= found <= own.upper + 1e-9, objective
        answers += 1
    assert answers > 5
