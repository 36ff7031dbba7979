// Merges what two people made of one plan, element by element: places, transitions and arcs by their names, rows of the
// policy, and every field of the plan file. Pure functions on states of a PlanDocument, {plan, net, policy}.

import { changed, freeName, freeTitle, groupsIn, namesOf } from "./net_edits.js";
import { renamed } from "./rename.js";
import { typeOf } from "./schema.js";

const isObject = (value) => typeOf(value) === "object";

/** Whether two JSON values are equal; undefined, which stands for an absent one, equals only itself. */
export function same(a, b) {
  if (a === b) return true;
  if (typeof a !== "object" || typeof b !== "object" || a === null || b === null) return false;
  if (Array.isArray(a) !== Array.isArray(b)) return false;
  const keys = Object.keys(a);
  return (
    keys.length === Object.keys(b).length &&
    keys.every((key) => Object.hasOwn(b, key) && same(a[key], b[key]))
  );
}

/** Where a conflict is, as one text. */
export const placeOf = ({ where }) => JSON.stringify(where);

/** The items of a list by key; if several have the same key, the later ones get a number. */
function byKey(list, keyOf) {
  const found = new Map();
  for (const item of list) {
    let key = keyOf(item);
    for (let n = 2; found.has(key); n++) key = `${keyOf(item)} (${n})`;
    found.set(key, item);
  }
  return found;
}

/** The rows of a policy without their columns: each marking has its counts by place, and leaves out "-". */
const loose = ({ places, rows }) =>
  rows.map((row) => ({
    ...row,
    marking: Object.fromEntries(
      places.map((place, i) => [place, row.marking[i]]).filter(([, cell]) => cell !== "-"),
    ),
  }));

/** Rows by key: equal rows have the key that they have in `base`, as does a row that follows the same row as there. */
function rowsByKey(rows, base) {
  const texts = base.map((row) => JSON.stringify(row));
  const free = new Map();
  texts.forEach((text, i) => free.set(text, [...(free.get(text) ?? []), i]));
  const paired = rows.map((row) => free.get(JSON.stringify(row))?.shift());
  const taken = new Set(paired);
  let before = -1;
  rows.forEach((_, i) => {
    const next = before + 1;
    if (paired[i] === undefined && next < base.length && !taken.has(next)) {
      paired[i] = next;
      taken.add(next);
    }
    before = paired[i] ?? before;
  });
  const numbered = new Map(rows.map((row, i) => [row, paired[i]]));
  return byKey(rows, (row) =>
    numbered.get(row) === undefined ? `new ${JSON.stringify(row)}` : `${numbered.get(row) + 1}`,
  );
}

class Merge {
  /** `prefer`: the conflicts, as `placeOf` names them, in which the other's value is taken. */
  constructor(prefer) {
    this.prefer = prefer;
    this.conflicts = [];
    this.taken = []; // where the other's values are taken because only those changed
  }

  value(base, mine, theirs, where) {
    if (same(mine, theirs)) return mine;
    if (isObject(mine) && isObject(theirs))
      return this.object(isObject(base) ? base : {}, mine, theirs, where);
    if (same(base, theirs)) return mine;
    if (same(base, mine)) {
      this.taken.push(where);
      return theirs;
    }
    this.conflicts.push({ where, mine, theirs });
    const chosen = this.prefer.has(placeOf({ where }));
    const [first, second] = chosen ? [theirs, mine] : [mine, theirs];
    return first === undefined ? second : first; // what one removed and the other changed stays
  }

  /** `how`: key -> function that merges the values of that key. */
  object(base, mine, theirs, where, how = {}) {
    const result = {};
    for (const key of new Set([...Object.keys(mine), ...Object.keys(theirs)])) {
      const value = how[key]
        ? how[key](base[key] ?? [], mine[key] ?? [], theirs[key] ?? [])
        : this.value(base[key], mine[key], theirs[key], [...where, key]);
      if (value !== undefined) result[key] = value;
    }
    const keys = Object.keys(result);
    return keys.length === Object.keys(mine).length &&
      keys.every((key) => result[key] === mine[key])
      ? mine
      : result;
  }

  /** Merge maps of items by key into a list: in the order of `mine` unless only `theirs` is in another one. */
  items(base, mine, theirs, where) {
    const found = new Map();
    for (const key of new Set([...mine.keys(), ...theirs.keys()])) {
      const value = this.value(base.get(key), mine.get(key), theirs.get(key), [...where, key]);
      if (value !== undefined) found.set(key, value);
    }
    const moved = (list) => {
      const kept = [...list.keys()].filter((key) => base.has(key));
      return !same(
        kept,
        [...base.keys()].filter((key) => list.has(key)),
      );
    };
    const [lead, other] = moved(theirs) && !moved(mine) ? [theirs, mine] : [mine, theirs];
    const after = new Map([[null, []]]); // key in the leading order -> those that follow it in the other one
    for (const key of lead.keys()) if (found.has(key)) after.set(key, []);
    let last = null;
    for (const key of other.keys())
      if (after.has(key)) last = key;
      else if (found.has(key)) after.get(last).push(key);
    return [...after]
      .flatMap(([key, more]) => (key === null ? more : [key, ...more]))
      .map((key) => found.get(key));
  }

  list(base, mine, theirs, keyOf, kind) {
    const result = this.items(...[base, mine, theirs].map((list) => byKey(list, keyOf)), [kind]);
    return result.length === mine.length && result.every((item, i) => item === mine[i])
      ? mine
      : result;
  }

  policy(base, mine, theirs) {
    const parts = [base ?? { places: [], rows: [] }, mine, theirs];
    if (
      !mine ||
      !theirs ||
      parts.some(({ rows }) => !rows.every((row) => Array.isArray(row.marking)))
    )
      return this.value(base, mine, theirs, ["policy"]);
    const [first, ...rows] = parts.map(loose);
    const both = this.object(...parts, ["policy"], {
      places: (...lists) => this.list(...lists, (name) => name, "column of the policy"),
      rows: () =>
        this.items(rowsByKey(first, first), ...rows.map((list) => rowsByKey(list, first)), [
          "policy row",
        ]),
    });
    const { places } = both;
    const back = both.rows.map((row) => ({
      ...row,
      marking: places.map((place) => row.marking[place] ?? "-"),
    }));
    const result = { ...both, rows: back };
    return same(result, mine) ? mine : result;
  }
}

/** The groups of `base` that have another title in `plan`: title -> title. Their nodes that are left are all in a group
 * that `base` has not. */
function retitled(base, plan) {
  const [was, now] = [groupsIn(base), groupsIn(plan)];
  const made = Object.keys(now).filter((title) => !Object.hasOwn(was, title));
  const found = Object.keys(was)
    .filter((title) => !Object.hasOwn(now, title))
    .map((title) => [
      title,
      made.filter((it) => now[it].some((name) => was[title].includes(name))),
    ]);
  return new Map(
    found.filter(([, { length }]) => length === 1).map(([title, [to]]) => [title, to]),
  );
}

/** A plan whose groups are merged node by node: `groups` says for each node in which one it is. `titles`: those that
 * somebody else has changed. */
const byNode = (plan, titles) => {
  const of = Object.entries(groupsIn(plan)).flatMap(([title, names]) =>
    names.map((name) => [name, titles.get(title) ?? title]),
  );
  return plan && { ...plan, groups: Object.fromEntries(of) };
};

/** The plan of a state with lists of nodes as groups again, as in `first`, and without nodes that are gone. */
function withLists(state, first) {
  if (!state.plan) return state.plan;
  const has = namesOf(state.net);
  const of = Object.entries(state.plan.groups).filter(([name]) => has.has(name));
  const groups = {};
  for (const title of [...Object.keys(groupsIn(first)), ...of.map((it) => it[1])]) {
    const names = of.filter((it) => it[1] === title).map(([name]) => name);
    if (names.length) groups[title] = names;
  }
  const plan = changed(state.plan, { groups: Object.keys(groups).length ? groups : undefined });
  return same(plan, first) ? first : plan;
}

/** The state with the nodes that an arc or an action needs and that somebody removed; `merge` notes each. */
function withNeeded(state, states, merge) {
  const has = namesOf(state.net);
  const wanted = [
    ...state.net.arcs.flatMap(({ from, to }) => [from, to]),
    ...Object.keys(state.plan?.actions ?? {}),
  ];
  const net = { ...state.net };
  for (const name of wanted) {
    if (has.has(name)) continue;
    has.add(name);
    for (const [kind, list] of [
      ["place", "places"],
      ["transition", "transitions"],
    ]) {
      const found = states.flatMap((one) => one.net[list]).find((node) => node.name === name);
      if (!found) continue;
      net[list] = [...net[list], found];
      merge.conflicts.push({ where: [kind, name], needed: true });
      break;
    }
  }
  return merge.conflicts.some(({ needed }) => needed) ? { ...state, net } : state;
}

/** Nodes and groups that both sides added under one name and that differ: ours get free names. */
function apart(base, mine, theirs) {
  const nodes = ({ net }) =>
    new Map(
      ["place", "transition"].flatMap((kind) =>
        net[`${kind}s`].map((data) => [data.name, { kind, data }]),
      ),
    );
  const [before, other] = [nodes(base), nodes(theirs)];
  const taken = new Set(other.keys());
  let state = mine;
  for (const [name, { kind, data }] of nodes(mine)) {
    const theirNode = other.get(name);
    if (before.has(name) || !theirNode || same(theirNode, { kind, data })) continue;
    const free = freeName(state.net, name, taken);
    taken.add(free);
    state = renamed(state, kind, name, free);
  }
  const groups = ({ plan }) => groupsIn(plan);
  const both = { groups: { ...groups(theirs), ...groups(state) } };
  const again = Object.entries(groups(state)).map(([title, names]) => {
    const differs = Object.hasOwn(groups(theirs), title) && !same(groups(theirs)[title], names);
    if (!differs || Object.hasOwn(groups(base), title)) return [title, names];
    return [freeTitle(both, title), names];
  });
  if (again.some(([title]) => !Object.hasOwn(groups(state), title)))
    return { ...state, plan: { ...state.plan, groups: Object.fromEntries(again) } };
  return state;
}

const NONE = new Set();

/** Merge what two people made of `base`. Returns {state, conflicts, taken}. A conflict is {where, mine, theirs}, an
 * element or a field that both changed: `mine` is taken, or `theirs` if `prefer` has its `placeOf`. Or it is {where,
 * needed: true}: a node that one removed and the other needs, which stays. `taken`: where the other's changes are.
 * Nodes of one name that both added get two names if `rename`. Parts that are as in `mine` are the same objects. */
export function merged(base, mine, theirs, { prefer = NONE, rename = true } = {}) {
  if (theirs === base) return { state: mine, conflicts: [], taken: [] };
  const own = rename ? apart(base, mine, theirs) : mine;
  const merge = new Merge(prefer);
  const named = ({ name }) => name;
  const listed =
    (keyOf, kind) =>
    (...lists) =>
      merge.list(...lists, keyOf, kind);
  const net = merge.object(base.net, own.net, theirs.net, ["net"], {
    places: listed(named, "place"),
    transitions: listed(named, "transition"),
    arcs: listed(({ from, to }) => `${from} → ${to}`, "arc"),
  });
  const [ownTitles, titles] = [own, theirs].map(({ plan }) => retitled(base.plan, plan));
  const plan = merge.value(
    byNode(base.plan, new Map([...titles, ...ownTitles])),
    byNode(own.plan, titles),
    byNode(theirs.plan, ownTitles),
    ["plan"],
  );
  const policy = merge.policy(base.policy, own.policy, theirs.policy);
  const whole = withNeeded({ ...own, net, plan, policy }, [own, theirs, base], merge);
  const state = { ...whole, plan: withLists(whole, mine.plan) };
  const unchanged = ["net", "plan", "policy"].every((key) => state[key] === mine[key]);
  return { state: unchanged ? mine : state, conflicts: merge.conflicts, taken: merge.taken };
}

const shown = (value) => {
  if (value === undefined) return "none";
  const text = typeof value === "string" ? value : JSON.stringify(value);
  return text.length > 60 ? `${text.slice(0, 57)}…` : text;
};

/** A conflict in words. */
export function conflictText({ where, mine, theirs, needed }) {
  const [kind, name, ...fields] = where;
  const element = [[kind, name].filter(Boolean).join(" "), ...fields].join(", ");
  if (!fields.length && !needed)
    return mine === undefined
      ? `${element}: you removed it, the other changed it, so it stays`
      : `${element}: you changed it, the other ${theirs === undefined ? "removed it, so it stays" : "too"}`;
  return needed
    ? `${element}: one of you removed it, the other needs it, so it stays`
    : `${element}: yours is ${shown(mine)}, theirs ${shown(theirs)}`;
}
