// Renames or removes places and transitions everywhere in a plan where their names occur. Pure functions on the state
// of a PlanDocument, {plan, net, policy}.

import { NAMES } from "./names.js";
import { arcKey, changed, namesOf } from "./net_edits.js";
import { scaled, sumOf } from "./schema.js";

const NAME = /^[\p{L}_][\p{L}\p{N}_.:]*$/u; // a name that needs no quotes in a condition; as in model/expression.py
const TOKEN = /"[^"]*"|'[^']*'|[\p{L}_][\p{L}\p{N}_.:]*/gu;
const COUNT = /#\s*("[^"]*"|'[^']*'|[\p{L}_][\p{L}\p{N}_.:]*)/gu; // the tokens of a place in a rate or weight
const WORDS = new Set(
  "and or not true false min max floor ceil round abs sqrt exp log ln pow mod".split(" "),
);
/** Whether a text is a word of conditions, which is the name of a place only in quotes. */
export const isWord = (text) => WORDS.has(text.toLowerCase());
const unquoted = (token) => (/^["']/.test(token) ? token.slice(1, -1) : token);
const inQuotes = (name) => (name.includes("'") ? `"${name}"` : `'${name}'`);

const nodesOf = (net, kind) => (kind === "place" ? net.places : net.transitions);

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
    if (/^(and|or)$/i.test(token)) return token;
    const name = unquoted(token);
    const now = place(name);
    if (now === name) return token;
    if (now === null) {
      gone = true;
      return token;
    }
    return NAME.test(now) && !isWord(now) ? now : inQuotes(now);
  });
  return gone ? null : result;
}

/** A transition whose rate and weight name places by their new names. A removed place stays, and the check names it. */
function withPlaces(transition, place) {
  const written = (text) =>
    text.replace(COUNT, (whole, token) => {
      const name = unquoted(token);
      const now = place(name) ?? name;
      return now === name ? whole : `#${NAME.test(now) ? now : inQuotes(now)}`;
    });
  let now = transition;
  for (const key of ["rate", "weight"])
    if (typeof now[key] === "string") now = with_(now, { [key]: written(now[key]) });
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

const keep = (it) => it;

/** An object with some of its values replaced; the same one if nothing changes. */
const with_ = (object, values) =>
  Object.entries(values).every(([key, value]) => object[key] === value)
    ? object
    : { ...object, ...values };

/** The state with every name of a place or a transition changed. `place(name)` and `transition(name)` return the new
 * name, or null for a removed node: whatever refers to it is removed too and reported by `said`. */
function changedNames(state, place, transition, said) {
  const { plan, policy } = state;
  const node = (name) => {
    const now = place(name);
    return now === name ? transition(name) : now;
  };

  // what changes the value of a key: maps, lists, and objects with known fields
  const map = (key, value, lost) => (it) => mapped(it, key, value, lost);
  const by = (key, what, value) => map(key, value, (name) => said(`${what} of '${name}'`));
  const list = (item, lost) => (it) => mappedList(it, item, lost);
  const fields = (how) => (it) => {
    if (!it || typeof it !== "object") return it;
    const there = Object.entries(how).filter(([key]) => it[key]);
    return with_(it, Object.fromEntries(there.map(([key, change]) => [key, change(it[key])])));
  };
  const optional = (change) => (name) => (name ? change(name) : name);
  const filled = (change) => (it) => {
    const now = change(it);
    return now !== it && !Object.keys(now).length ? null : now;
  };
  const reported = (change, text) => (it) => {
    const now = change(it);
    if (now === null) said(text(it));
    return now;
  };
  const fires = (text) => {
    if (typeof text !== "string" || !text.startsWith("fire ")) return text;
    const now = transition(text.slice(5));
    return now === null ? null : now === text.slice(5) ? text : `fire ${now}`;
  };
  const action = fields({
    outcomes: map(keep, optional(transition)),
    share: map(keep, place, (name) => said(`the share of '${name}'`)),
  });
  const startsThere = (name) => said(`the robot '${name}', which starts there`);
  const robot = fields({ place, actions: map(place, action) });
  const outcomes = (entry) => {
    const before = entry?.probabilities;
    const left = before && filled(map(optional(transition)))(before);
    if (left === before) return entry;
    return left && { ...entry, probabilities: adjusted(left, before) };
  };

  const changes = {};
  const RULES = {
    actions: by(place, "the action", action),
    on_failure: by(
      place,
      "the failure rule",
      reported(
        (rule) => (typeof rule === "string" ? fires(rule) : mapped(rule, keep, fires)),
        (rule) => `the rule '${rule}'`,
      ),
    ),
    timeout: by(place, "the time-out"),
    on_evict: by(place, "the resources given back on eviction", map(place)),
    durations: by(place, "the duration"),
    outcomes: by(place, "the outcomes", outcomes),
    failures: by(place, "the probability of failure"),
    routing: by(transition, "the routing", filled(map(place, place))),
    events: by(transition, "the event"),
    rates: by(transition, "the rate that replaces the net's"),
    resource_places: list(place),
    spawn: list(place, () => said("a place of 'spawn'")),
    chance: list(place),
    robots: (robots) =>
      Array.isArray(robots)
        ? mappedList(
            robots,
            (it) => (place(it.place) === null ? null : robot(it)),
            ({ name }) => startsThere(name),
          )
        : mapped(robots, keep, place, startsThere),
    own_times: (times) => {
      const left = plan.robots && new Set(NAMES.robots({ plan: { ...plan, ...changes } }));
      const own = { durations: map(place), outcomes: map(place, outcomes), failures: map(place) };
      return mapped(times, (name) => (!left || left.has(name) ? name : null), fields(own));
    },
    tasks: fields({
      queues: list(place),
      order: map(place),
      on_cancel: map(place, optional(transition), (name) =>
        said(`where a robot goes from '${name}' if its task is cancelled`),
      ),
      done: list(transition),
    }),
    on_lost: reported(fires, (rule) => `the rule '${rule}' for lost robots`),
    until: reported(
      (text) => changedCondition(text, place),
      (text) => `the condition “until” (${text})`,
    ),
    groups: map(keep, filled(list(node))),
    subnets: map(place, (part) =>
      [part.entry, part.exit].map(place).includes(null)
        ? null
        : fields({
            entry: place,
            exit: place,
            places: list(place),
            transitions: list(transition),
            parent: (name) => place(name) ?? undefined,
          })(part),
    ),
  };

  const net = changedNet(state.net, place, transition, node, said);
  for (const key of Object.keys(RULES).filter((it) => plan[it])) {
    const value = RULES[key](plan[key]);
    const empty = value === null || (key !== "actions" && !Object.keys(value).length);
    if (value !== plan[key]) changes[key] = empty ? undefined : value;
  }
  return {
    plan: Object.keys(changes).length ? changed(plan, changes) : plan,
    net,
    policy: policy && changedPolicy(policy, place, transition, said),
  };
}

function changedNet(net, place, transition, node, said) {
  const named = (change) => (it) => {
    const name = change(it.name);
    return name === null ? null : with_(it, { name });
  };
  let arcs = 0;
  const result = with_(net, {
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
  return result;
}

/** The remaining probabilities, scaled to their previous sum. */
const adjusted = (left, before) =>
  Object.keys(left).length === Object.keys(before).length ? left : scaled(left, sumOf(before));

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
  const before = (row) => row - lost.filter((at) => at < row).length;
  const scopes = mappedList(policy.scopes, (scope) => {
    const numbers = scope.rows.map(before);
    return with_(scope, {
      places: mappedList(scope.places, place),
      rows: same(numbers, scope.rows) ? scope.rows : numbers,
    });
  });
  return with_(policy, {
    places,
    rows: same(rows, policy.rows) ? policy.rows : rows,
    ...(scopes && { scopes }),
  });
}

/** The state with a place or a transition renamed. The names inside a place that stands for a plan begin with its name
 * ("Charge.Approach"), so these change too. */
export function renamed(state, kind, from, to) {
  const inside = kind === "place" && state.plan.actions?.[from]?.plan !== undefined;
  const own = namesOf(state.net);
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
  const own = namesOf(state.net);
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
