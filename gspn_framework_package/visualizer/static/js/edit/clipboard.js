// Parts of a net as text, for copy and paste. Paste refuses any text that is not exactly of this form.

import { freeName, groupsIn, namesOf } from "./net_edits.js";
import { problemOf, typeOf } from "./schema.js";

const MARK = "gspn-part";

/** The selected nodes of a state, the arcs between them and the actions of the places: {places, transitions, arcs,
 * actions, resources, groups}; null if there are none. */
export function copied(state, keys, positions) {
  const { net, plan } = state;
  const withPlace = (node) => ({ ...node, position: positions.get(node.name) });
  const places = net.places.filter(({ name }) => keys.has(`place:${name}`)).map(withPlace);
  const transitions = net.transitions
    .filter(({ name }) => keys.has(`transition:${name}`))
    .map(withPlace);
  if (!places.length && !transitions.length) return null;
  const names = namesOf({ places, transitions });
  const arcs = net.arcs.filter((arc) => names.has(arc.from) && names.has(arc.to));
  const actions = {};
  for (const { name } of places)
    if (plan?.actions && Object.hasOwn(plan.actions, name)) actions[name] = plan.actions[name];
  const resources = (plan?.resource_places || []).filter((name) => names.has(name));
  const whole = ([, nodes]) => nodes.every((name) => names.has(name));
  const groups = Object.fromEntries(Object.entries(groupsIn(plan)).filter(whole));
  return { places, transitions, arcs, actions, resources, groups };
}

/** Such a part as text. */
export const partText = (part) => JSON.stringify({ [MARK]: 1, ...part }, null, 1);

/** The part that `text` holds; null if it is not a part of a net. `schema`: that of plan files. */
export function parsed(text, schema) {
  let data;
  try {
    data = JSON.parse(text);
  } catch {
    return null;
  }
  if (typeOf(data) !== "object" || data[MARK] !== 1) return null;
  const { places, transitions, arcs, actions = {}, resources = [], groups = {} } = data;
  const problem =
    problemOf(schema.definitions.net, { places, transitions, arcs }, schema) ||
    problemOf(schema.properties.resource_places, resources, schema) ||
    problemOf(schema.properties.groups, groups, schema);
  if (problem || typeOf(actions) !== "object") return null;
  const nodes = [...places, ...transitions];
  const names = namesOf({ places, transitions });
  const isPlace = new Set(places.map(({ name }) => name));
  const grouped = Object.values(groups).flat();
  const fits =
    names.size === nodes.length &&
    nodes.every(({ name, position }) => name.trim() && position) &&
    arcs.every(
      ({ from, to, inhibitor }) =>
        [from, to].every((end) => names.has(end)) &&
        isPlace.has(from) !== isPlace.has(to) &&
        (!inhibitor || isPlace.has(from)),
    ) &&
    grouped.every((name) => names.has(name)) &&
    new Set(grouped).size === grouped.length;
  return fits
    ? {
        places,
        transitions,
        arcs,
        actions: Object.fromEntries(Object.entries(actions).filter(([name]) => isPlace.has(name))),
        resources: resources.filter((name) => isPlace.has(name)),
        groups,
      }
    : null;
}

/** A copy of a part with names that are new to the net, its positions changed by `move(x, y)`. */
export function fitted(part, net, move) {
  const names = new Map();
  const taken = new Set();
  for (const { name } of [...part.places, ...part.transitions]) {
    const free = freeName(net, name, taken);
    names.set(name, free);
    taken.add(free);
  }
  const node = (data) => ({
    ...data,
    name: names.get(data.name),
    position: move(...data.position),
  });
  return {
    places: part.places.map(node),
    transitions: part.transitions.map(node),
    arcs: part.arcs.map((arc) => ({
      ...arc,
      from: names.get(arc.from),
      to: names.get(arc.to),
      ...(arc.bends ? { bends: arc.bends.map(([x, y]) => move(x, y)) } : {}),
    })),
    actions: Object.fromEntries(
      Object.entries(part.actions).map(([name, action]) => [names.get(name), action]),
    ),
    resources: part.resources.map((name) => names.get(name)),
    groups: Object.fromEntries(
      Object.entries(part.groups ?? {}).map(([title, nodes]) => [
        title,
        nodes.map((name) => names.get(name)),
      ]),
    ),
  };
}
