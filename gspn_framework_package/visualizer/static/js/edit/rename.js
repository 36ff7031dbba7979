// Renames or removes places and transitions everywhere in a plan where their names occur. Pure functions on the state
// of a PlanDocument, {plan, net, policy}.

import { NAMES } from "./names.js";

const NAME = /^[\p{L}_][\p{L}\p{N}_.:]*$/u; // a name that needs no quotes in a condition; as in model/expression.py
const TOKEN = /"[^"]*"|'[^']*'|[\p{L}_][\p{L}\p{N}_.:]*/gu;
const COUNT = /#\s*("[^"]*"|'[^']*'|[\p{L}_][\p{L}\p{N}_.:]*)/gu; // the tokens of a place in a rate or weight
const WORDS = new Set(
  "and or not true false min max floor ceil round abs sqrt exp log ln pow mod".split(" "),
);

const nodesOf = (net, kind) => (kind === "place" ? net.places : net.transitions);

/** The key of an arc in a selection. */
export const arcKey = (arc) => `arc:${arc.from}>${arc.to}`;

/** Why a node cannot be called `name`; "" if it can. `except`: its present name. */
export function problemOfName(state, name, except = null) {
  if (!name.trim()) return "a name is needed";
  if (name !== name.trim()) return "a name neither begins nor ends with a space";
  if (name === except) return "";
  if (name === "*") return "'*' stands for every place";
  for (const kind of ["place", "transition"])
    if (nodesOf(state.net, kind).some((node) => node.name === name))
      return `there is a ${kind} '${name}' already`;
  if (name.includes("'") && name.includes('"')) return "a name has one kind of quotes at most";
  return "";
}

/** The text of a condition with the names of places changed; null if it names a removed place. */
export function changedCondition(text, place) {
  let gone = false;
  const result = text.replace(TOKEN, (token) => {
    const quoted = /^["']/.test(token);
    const name = quoted ? token.slice(1, -1) : token;
    if (!quoted && /^(and|or)$/i.test(name)) return token;
    const now = place(name);
    if (now === name) return token;
    if (now === null) {
      gone = true;
      return token;
    }
    if (NAME.test(now) && !WORDS.has(now.toLowerCase())) return now;
    return now.includes("'") ? `"${now}"` : `'${now}'`;
  });
  return gone ? null : result;
}

/** A transition whose rate and weight name places by their new names. A removed place stays, and the check names it. */
function withPlaces(transition, place) {
  const changed = (text) =>
    text.replace(COUNT, (whole, token) => {
      const name = /^["']/.test(token) ? token.slice(1, -1) : token;
      const now = place(name) ?? name;
      if (now === name) return whole;
      return NAME.test(now) ? `#${now}` : now.includes("'") ? `#"${now}"` : `#'${now}'`;
    });
  let now = transition;
  for (const key of ["rate", "weight"])
    if (typeof now[key] === "string" && changed(now[key]) !== now[key])
      now = { ...now, [key]: changed(now[key]) };
  return now;
}

const same = (a, b) => a.length === b.length && a.every((item, i) => item === b[i]);

/** An object with its keys and values changed; entries that become null are removed. Returns the same object if nothing
 * changes. */
function mapped(object, key, value = (it) => it, lost = () => {}) {
  if (!object || typeof object !== "object") return object;
  const before = Object.entries(object);
  const after = [];
  for (const [k, v] of before) {
    const [now, found] = [key(k), value(v, k)];
    if (now === null || (found === null && v !== null))
      lost(k); // null is an action too
    else after.push([now, found]);
  }
  return same(before.flat(), after.flat()) ? object : Object.fromEntries(after);
}

function mappedList(list, item, lost = () => {}) {
  if (!Array.isArray(list)) return list;
  const after = list.map(item).filter((it, i) => it !== null || lost(list[i]));
  return same(list, after) ? list : after;
}

const PLACE_KEYS = [
  "actions",
  "on_failure",
  "timeout",
  "on_evict",
  "durations",
  "outcomes",
  "failures",
];
const PLACE_LISTS = ["resource_places", "spawn", "chance"];
const TRANSITION_KEYS = ["routing", "events", "rates"];
const WHAT = {
  actions: "the action",
  on_failure: "the failure rule",
  timeout: "the time-out",
  on_evict: "the resources given back on eviction",
  durations: "the duration",
  outcomes: "the outcomes",
  failures: "the probability of failure",
  routing: "the routing",
  events: "the event",
  rates: "the rate that replaces the net's",
};

/** The state with every name of a place or a transition changed. `place(name)` and `transition(name)` return the new
 * name, or null for a removed node: whatever refers to it is removed too and reported by `said`. */
function changedNames(state, place, transition, said) {
  const { net, plan, policy } = state;
  const node = (name) => {
    const now = place(name);
    return now === name ? transition(name) : now;
  };
  const fires = (text) => {
    if (typeof text !== "string" || !text.startsWith("fire ")) return text;
    const now = transition(text.slice(5));
    return now === null ? null : now === text.slice(5) ? text : `fire ${now}`;
  };
  const with_ = (object, values) =>
    Object.entries(values).every(([key, value]) => object[key] === value)
      ? object
      : { ...object, ...values };

  // the net
  const named = (change) => (it) => {
    const now = change(it.name);
    return now === null ? null : with_(it, { name: now });
  };
  let arcs = 0;
  const newNet = with_(net, {
    places: mappedList(net.places, named(place)),
    transitions: mappedList(net.transitions, (it) => named(transition)(withPlaces(it, place))),
    arcs: mappedList(
      net.arcs,
      (arc) => {
        const [from, to] = [node(arc.from), node(arc.to)];
        return from === null || to === null ? null : with_(arc, { from, to });
      },
      () => {
        arcs++;
      },
    ),
  });
  if (arcs) said(arcs === 1 ? "an arc" : `${arcs} arcs`);

  // actions: the transitions of their outcomes, and the resources that a subnet shares
  const action = (it) => {
    if (!it || typeof it !== "object") return it;
    let now = it;
    if (it.outcomes) {
      const outcomes = mapped(
        it.outcomes,
        (k) => k,
        (t) => (t ? transition(t) : t),
      );
      if (outcomes !== it.outcomes) now = { ...now, outcomes };
    }
    if (it.share) {
      const share = mapped(
        it.share,
        (k) => k,
        (p) => place(p),
        (k) => said(`the share of '${k}'`),
      );
      if (share !== it.share) now = { ...now, share };
    }
    return now;
  };
  const values = {};
  const put = (key, value, empty = Object.keys(value ?? {}).length === 0) => {
    if (value !== plan[key]) values[key] = empty && key !== "actions" ? undefined : value;
  };
  const VALUE = {
    actions: action,
    on_failure: (rule) => {
      const now = typeof rule === "string" ? fires(rule) : mapped(rule, (k) => k, fires);
      if (now === null) said(`the rule '${rule}'`);
      return now;
    },
    on_evict: (returned) => mapped(returned, place),
    outcomes: (entry) => {
      if (!entry?.probabilities) return entry;
      const probabilities = mapped(entry.probabilities, (t) => (t ? transition(t) : t));
      if (probabilities === entry.probabilities) return entry;
      if (!Object.keys(probabilities).length) return null;
      return { ...entry, probabilities: adjusted(probabilities, entry.probabilities) };
    },
    routing: (ways) => {
      const now = mapped(ways, place, place);
      return Object.keys(now).length ? now : null;
    },
  };
  for (const [keys, change] of [
    [PLACE_KEYS, place],
    [TRANSITION_KEYS, transition],
  ])
    for (const key of keys)
      if (plan[key])
        put(
          key,
          mapped(plan[key], change, VALUE[key], (name) => said(`${WHAT[key]} of '${name}'`)),
        );
  for (const key of PLACE_LISTS)
    if (plan[key])
      put(
        key,
        mappedList(
          plan[key],
          place,
          key === "spawn" ? () => said("a place of 'spawn'") : undefined,
        ),
      );

  // robots
  if (Array.isArray(plan.robots))
    put(
      "robots",
      mappedList(
        plan.robots,
        (robot) => {
          const at = place(robot.place);
          if (at === null) return null;
          const own = robot.actions && mapped(robot.actions, place, action);
          return with_(robot, own ? { place: at, actions: own } : { place: at });
        },
        (robot) => said(`the robot '${robot.name}', which starts there`),
      ),
    );
  else if (plan.robots)
    put(
      "robots",
      mapped(
        plan.robots,
        (name) => name,
        place,
        (name) => said(`the robot '${name}', which starts there`),
      ),
    );

  if (plan.own_times) {
    const left = plan.robots && new Set(NAMES.robots({ plan: { ...plan, ...values } }));
    const key = (robot) => (!left || left.has(robot) ? robot : null);
    const times = (of) =>
      Object.entries(of).map(([kind, it]) => [kind, mapped(it, place, VALUE[kind])]);
    put(
      "own_times",
      mapped(plan.own_times, key, (of) => with_(of, Object.fromEntries(times(of)))),
    );
  }

  // the rest of the plan
  if (plan.tasks)
    put(
      "tasks",
      with_(plan.tasks, {
        ...(plan.tasks.queues && { queues: mappedList(plan.tasks.queues, place) }),
        ...(plan.tasks.order && { order: mapped(plan.tasks.order, place) }),
        ...(plan.tasks.on_cancel && {
          on_cancel: mapped(
            plan.tasks.on_cancel,
            place,
            (name) => (name ? transition(name) : name),
            (name) => said(`where a robot goes from '${name}' if its task is cancelled`),
          ),
        }),
        ...(plan.tasks.done && { done: mappedList(plan.tasks.done, transition) }),
      }),
    );
  if (plan.on_lost) {
    const now = fires(plan.on_lost);
    if (now === null) said(`the rule '${plan.on_lost}' for lost robots`);
    put("on_lost", now ?? undefined, false);
  }
  if (plan.until) {
    const now = changedCondition(plan.until, place);
    if (now === null) said(`the condition “until” (${plan.until})`);
    put("until", now ?? undefined, false);
  }
  if (plan.groups)
    put(
      "groups",
      mapped(
        plan.groups,
        (title) => title,
        (nodes) => {
          const left = mappedList(nodes, node);
          return left?.length === 0 ? null : left;
        },
      ),
    );
  if (plan.subnets)
    put(
      "subnets",
      mapped(plan.subnets, place, (part) => {
        const [entry, exit] = [place(part.entry), place(part.exit)];
        if (entry === null || exit === null) return null;
        return with_(part, {
          entry,
          exit,
          places: mappedList(part.places, place),
          transitions: mappedList(part.transitions, transition),
          ...(part.parent && { parent: place(part.parent) ?? undefined }),
        });
      }),
    );
  let newPlan = plan;
  if (Object.keys(values).length) {
    newPlan = {};
    for (const key of Object.keys(plan)) {
      const value = key in values ? values[key] : plan[key];
      if (value !== undefined) newPlan[key] = value;
    }
  }
  return {
    plan: newPlan,
    net: newNet,
    policy: policy && changedPolicy(policy, place, transition, said),
  };
}

/** The remaining probabilities, scaled to their previous sum. */
function adjusted(left, before) {
  if (Object.keys(left).length === Object.keys(before).length) return left;
  const sum = (of) => Object.values(of).reduce((total, value) => total + Number(value), 0);
  const [now, was] = [sum(left), sum(before)];
  if (!(now > 0)) {
    const each = was / Object.keys(left).length;
    return Object.fromEntries(Object.keys(left).map((key) => [key, each]));
  }
  return Object.fromEntries(
    Object.entries(left).map(([key, value]) => [
      key,
      Number(((Number(value) * was) / now).toPrecision(12)),
    ]),
  );
}

function changedPolicy(policy, place, transition, said) {
  const gone = policy.places.map((name) => place(name) === null);
  const places = mappedList(policy.places, place, (name) =>
    said(`the column '${name}' of the policy`),
  );
  const lost = []; // numbers of the rows that are removed
  let rescaled = 0;
  const rows = mappedList(
    policy.rows.map((row, i) => [row, i]),
    ([row, i]) => {
      const choose = mapped(row.choose, transition);
      if (choose === row.choose && !gone.includes(true)) return row;
      if (!Object.keys(choose).length && Object.keys(row.choose).length) {
        lost.push(i);
        return null; // an empty choice would make the robots wait
      }
      const fitted = adjusted(choose, row.choose);
      if (fitted !== choose) rescaled++;
      return { ...row, marking: row.marking.filter((_, at) => !gone[at]), choose: fitted };
    },
  );
  if (lost.length)
    said(
      lost.length === 1
        ? `row ${lost[0] + 1} of the policy, which chose nothing else`
        : `${lost.length} rows of the policy, which chose nothing else`,
    );
  if (rescaled) said(`its share in ${rescaled === 1 ? "a row" : `${rescaled} rows`} of the policy`);
  const result = { ...policy };
  let differs = places !== policy.places;
  result.places = places;
  if (!same(rows, policy.rows)) {
    result.rows = rows;
    differs = true;
  }
  if (policy.scopes) {
    const before = (row) => row - lost.filter((at) => at < row).length;
    const scopes = policy.scopes.map((scope) => {
      const kept = mappedList(scope.places, place);
      const [first, last] = scope.rows.map(before);
      return kept === scope.places && first === scope.rows[0] && last === scope.rows[1]
        ? scope
        : { ...scope, places: kept, rows: [first, last] };
    });
    if (!same(scopes, policy.scopes)) {
      result.scopes = scopes;
      differs = true;
    }
  }
  return differs ? result : policy;
}

/** The state with a place or a transition renamed. The names inside a place that stands for a plan begin with its name
 * ("Charge.Approach"), so these change too. */
export function renamed(state, kind, from, to) {
  const inside = kind === "place" && state.plan.actions?.[from]?.plan !== undefined;
  const own = new Set([...state.net.places, ...state.net.transitions].map(({ name }) => name));
  const part = (name) =>
    inside && name.startsWith(`${from}.`) && !own.has(name) ? to + name.slice(from.length) : name;
  const change = (wanted) => (name) => (kind === wanted && name === from ? to : part(name));
  return changedNames(state, change("place"), change("transition"), () => {});
}

/** The state without some nodes and arcs (keys as in a selection: "place:A", "arc:A>t") and without references to them.
 * `said` lists what else was removed. */
export function without(state, keys) {
  const gone = new Set(keys);
  const inside = state.net.places
    .map(({ name }) => name)
    .filter((name) => gone.has(`place:${name}`) && state.plan.actions?.[name]?.plan !== undefined);
  const own = new Set([...state.net.places, ...state.net.transitions].map(({ name }) => name));
  const lost = (kind) => (name) =>
    gone.has(`${kind}:${name}`) ||
    (!own.has(name) && inside.some((place) => name.startsWith(`${place}.`)))
      ? null
      : name;
  const said = [];
  const net = {
    ...state.net,
    arcs: mappedList(state.net.arcs, (arc) => (gone.has(arcKey(arc)) ? null : arc)),
  };
  const base = same(net.arcs, state.net.arcs) ? state : { ...state, net };
  const after = changedNames(base, lost("place"), lost("transition"), (text) => {
    if (!said.includes(text)) said.push(text);
  });
  return { state: after, said };
}
