// Parts of a net as text, for copy and paste. Paste refuses any text that is not exactly of this form.

import { freeName, groupsIn } from "./net_edits.js";

const MARK = "gspn-part";
const PLACE = { tokens: isCount, capacity: isCount };
const TRANSITION = {
  timed: (value) => typeof value === "boolean",
  rate: isValue,
  weight: (value) => value === 0 || isValue(value),
  priority: isCount,
  servers: (value) => isCount(value) || typeof value === "string",
};

function isCount(value) {
  return Number.isSafeInteger(value) && value >= 0;
}

/** Whether it may be a rate: a number above 0, or an expression, which the check reads. */
function isValue(value) {
  return (Number.isFinite(value) && value > 0) || isName(value);
}

const isName = (value) => typeof value === "string" && value.trim() !== "";
const isPoint = (value) =>
  Array.isArray(value) && value.length === 2 && value.every(Number.isFinite);
const isObject = (value) => value !== null && typeof value === "object" && !Array.isArray(value);

/** The selected nodes of a state, the arcs between them and the actions of the places, as text; "" if there are none.
 */
export function copied(state, keys, positions) {
  const { net, plan } = state;
  const withPlace = (node) => ({ ...node, position: positions.get(node.name) });
  const places = net.places.filter(({ name }) => keys.has(`place:${name}`)).map(withPlace);
  const transitions = net.transitions
    .filter(({ name }) => keys.has(`transition:${name}`))
    .map(withPlace);
  if (!places.length && !transitions.length) return "";
  const names = new Set([...places, ...transitions].map(({ name }) => name));
  const arcs = net.arcs.filter((arc) => names.has(arc.from) && names.has(arc.to));
  const actions = {};
  for (const { name } of places)
    if (plan?.actions && Object.hasOwn(plan.actions, name)) actions[name] = plan.actions[name];
  const resources = (plan?.resource_places || []).filter((name) => names.has(name));
  const whole = ([, nodes]) => nodes.every((name) => names.has(name));
  const groups = Object.fromEntries(Object.entries(groupsIn(plan)).filter(whole));
  const part = { places, transitions, arcs, actions, resources, groups };
  return JSON.stringify({ [MARK]: 1, ...part }, null, 1);
}

/** What `text` holds: {places, transitions, arcs, actions, resources, groups}; null if it is not a part of a net. */
export function parsed(text) {
  let data;
  try {
    data = JSON.parse(text);
  } catch {
    return null;
  }
  if (!isObject(data) || data[MARK] !== 1) return null;
  const { places, transitions, arcs, actions = {}, resources = [], groups = {} } = data;
  if (![places, transitions, arcs, resources].every(Array.isArray) || !isObject(actions))
    return null;
  if (!isObject(groups) || !Object.values(groups).every(Array.isArray)) return null;
  const names = new Set();
  const fits = (node, keys) => {
    if (!isObject(node) || !isName(node.name) || names.has(node.name)) return false;
    names.add(node.name);
    if (!isPoint(node.position)) return false;
    return Object.entries(keys).every(
      ([key, holds]) => node[key] === undefined || holds(node[key]),
    );
  };
  if (!places.every((p) => fits(p, PLACE)) || !transitions.every((t) => fits(t, TRANSITION)))
    return null;
  const isPlace = new Set(places.map(({ name }) => name));
  const joins = (arc) =>
    isObject(arc) &&
    (arc.bends === undefined || (Array.isArray(arc.bends) && arc.bends.every(isPoint))) &&
    names.has(arc.from) &&
    names.has(arc.to) &&
    isPlace.has(arc.from) !== isPlace.has(arc.to) &&
    (arc.weight === undefined || (isCount(arc.weight) && arc.weight > 0)) &&
    (arc.inhibitor === undefined ||
      (typeof arc.inhibitor === "boolean" && (!arc.inhibitor || isPlace.has(arc.from))));
  if (!arcs.every(joins)) return null;
  const grouped = Object.values(groups).flat();
  if (!grouped.every((name) => names.has(name)) || new Set(grouped).size < grouped.length)
    return null;
  const only = (object, keys) =>
    Object.fromEntries(
      Object.entries(object).filter(([key, value]) => keys.includes(key) && value !== undefined),
    );
  const common = ["name", "position"];
  return {
    places: places.map((p) => only(p, [...common, ...Object.keys(PLACE)])),
    transitions: transitions.map((t) => only(t, [...common, ...Object.keys(TRANSITION)])),
    arcs: arcs.map((arc) => only(arc, ["from", "to", "weight", "inhibitor", "bends"])),
    actions: Object.fromEntries(Object.entries(actions).filter(([name]) => isPlace.has(name))),
    resources: resources.filter((name) => isPlace.has(name)),
    groups,
  };
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
