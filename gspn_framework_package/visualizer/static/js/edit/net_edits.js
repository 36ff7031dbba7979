// Edits of a net, as functions from a state {plan, net, policy} to its changed parts. They do not depend on the page.

export const nodeKey = (kind, name) => `${kind}:${name}`;
/** The key of an arc in a selection. */
export const arcKey = (arc) => `arc:${arc.from}>${arc.to}`;

/** A copy of an object with some keys replaced; a key whose new value is undefined is removed. */
export function changed(object, values) {
  const result = { ...object, ...values };
  for (const [key, value] of Object.entries(values)) if (value === undefined) delete result[key];
  return result;
}

const LISTS = { place: "places", transition: "transitions" };

/** The kind and the object of a node: {kind, data}, or null. */
export function findNode(net, key) {
  for (const [kind, list] of Object.entries(LISTS))
    if (key.startsWith(`${kind}:`)) {
      const name = key.slice(kind.length + 1);
      const data = net[list].find((node) => node.name === name);
      return data ? { kind, data } : null;
    }
  return null;
}

/** The names of all nodes. */
export const namesOf = ({ places, transitions }) =>
  new Set([...places, ...transitions].map(({ name }) => name));

/** A name that no node has: the wanted one, or that with the next free number. */
export function freeName(net, wanted, taken = new Set()) {
  const names = namesOf(net);
  return nextFree(wanted, (name) => !names.has(name) && !taken.has(name));
}

/** A title that no group has, likewise. */
export const freeTitle = (plan, wanted) =>
  nextFree(wanted, (title) => !Object.hasOwn(groupsIn(plan), title));

function nextFree(wanted, free) {
  if (free(wanted)) return wanted;
  const [, stem, digits] = /^(.*?)(\d*)$/su.exec(wanted);
  for (let n = digits ? Number(digits) + 1 : 2; ; n++) {
    const name = digits ? `${stem}${n}` : `${stem}_${n}`;
    if (free(name)) return name;
  }
}

/** The groups of a plan that may be unfinished: title -> names of nodes. */
export const groupsIn = (plan) =>
  Object.fromEntries(
    Object.entries(plan?.groups ?? {}).filter(([, names]) => Array.isArray(names)),
  );

/** The plan with nodes in the group `title`, and in no other; in none if it is "". A group without nodes is gone. */
export function withGroup(plan, names, title) {
  const moved = new Set(names);
  const groups = {};
  for (const [other, nodes] of Object.entries(groupsIn(plan))) {
    const left = nodes.filter((name) => !moved.has(name));
    if (left.length || other === title) groups[other] = left;
  }
  if (title) groups[title] = [...(groups[title] ?? []), ...names];
  return changed(plan, { groups: Object.keys(groups).length ? groups : undefined });
}

/** The net with each node changed to what `change(data, kind)` returns; the same net if nothing changes. */
function mapNodes(net, change) {
  let result = net;
  for (const [kind, list] of Object.entries(LISTS)) {
    const nodes = net[list].map((data) => change(data, kind));
    if (nodes.some((node, i) => node !== net[list][i])) result = { ...result, [list]: nodes };
  }
  return result;
}

/** Replace the nodes with the given keys by what `change(data, key)` returns. */
export function changeNodes(net, keys, change) {
  const wanted = new Set(keys);
  return mapNodes(net, (data, kind) => {
    const key = nodeKey(kind, data.name);
    return wanted.has(key) ? change(data, key) : data;
  });
}

/** Give nodes positions: `positions`: name -> [x, y]. Nodes without one also get one (`all()`: name -> [x, y]), since a
 * net with incomplete positions is laid out again when it is opened. */
export function moveNodes(net, positions, all) {
  const bare = [...net.places, ...net.transitions].some((node) => !node.position);
  if (!bare && !positions.size) return net;
  const present = bare ? all() : null;
  const moved = mapNodes(net, (data) => {
    const wanted = positions.get(data.name) || (data.position ? null : present.get(data.name));
    if (!wanted) return data;
    const [x, y] = data.position || [];
    return x === wanted[0] && y === wanted[1] ? data : { ...data, position: wanted };
  });
  return net.arcs.some(({ bends }) => bends) ? carryBends(net, moved) : moved;
}

/** The net `moved` with the bends of each arc moved by the mean of what its ends have moved since `net`. */
function carryBends(net, moved) {
  const where = ({ places, transitions }) =>
    new Map([...places, ...transitions].map(({ name, position }) => [name, position]));
  const [was, now] = [where(net), where(moved)];
  const way = (name, axis) => (was.get(name) ? now.get(name)[axis] - was.get(name)[axis] : 0);
  const arcs = moved.arcs.map((arc) => {
    const [dx, dy] = [0, 1].map((axis) => (way(arc.from, axis) + way(arc.to, axis)) / 2);
    if (!arc.bends || (!dx && !dy)) return arc;
    const round = (value) => Math.round(value * 100) / 100;
    return { ...arc, bends: arc.bends.map(([x, y]) => [round(x + dx), round(y + dy)]) };
  });
  return { ...moved, arcs };
}

/** The net without bends. */
export const unbent = (net) => ({
  ...net,
  arcs: net.arcs.map((arc) => (arc.bends ? changed(arc, { bends: undefined }) : arc)),
});

/** Add nodes and arcs. */
export function addParts(net, { places = [], transitions = [], arcs = [] }) {
  return changed(net, {
    places: places.length ? [...net.places, ...places] : net.places,
    transitions: transitions.length ? [...net.transitions, ...transitions] : net.transitions,
    arcs: arcs.length ? [...net.arcs, ...arcs] : net.arcs,
  });
}

/** Why no arc may lead from one node to another; "" if one may. */
export function problemOfArc(net, from, to) {
  const [a, b] = [findNode(net, from), findNode(net, to)];
  if (!a || !b) return "No such node exists.";
  if (from === to) return "An arc joins two nodes.";
  if (a.kind === b.kind)
    return `An arc joins a place and a transition; both of these are ${a.kind}s.`;
  if (net.arcs.some((arc) => arc.from === a.data.name && arc.to === b.data.name))
    return `There is an arc from ${a.data.name} to ${b.data.name} already; + raises its weight.`;
  return "";
}

/** Replace the arcs with the given keys. */
export function changeArcs(net, keys, change) {
  const wanted = new Set(keys);
  let other = false;
  const arcs = net.arcs.map((arc) => {
    if (!wanted.has(arcKey(arc))) return arc;
    const after = change(arc);
    other = other || after !== arc;
    return after;
  });
  return other ? { ...net, arcs } : net;
}

/** A transition converted to the other kind; settings that do not apply to that kind are dropped. */
export function otherKind(transition) {
  if (transition.timed)
    return changed(transition, { timed: undefined, rate: undefined, servers: undefined });
  const { name, ...rest } = changed(transition, { weight: undefined, priority: undefined });
  return { name, timed: true, rate: 1, ...rest };
}
