// The names of nodes that belong in a field of a plan.

import { natural } from "../dom.js";

const sorted = new WeakMap(); // list of nodes -> its names; cached, since forms ask for them often

function names(nodes) {
  if (!sorted.has(nodes)) sorted.set(nodes, nodes.map(({ name }) => name).sort(natural));
  return [...sorted.get(nodes)];
}

/** The names that are valid in some position: (state, name of the entry) -> list. */
export const NAMES = {
  places: ({ net }) => names(net.places),
  nodes: ({ net }) => [...names(net.places), ...names(net.transitions)],
  placesAndAll: ({ net }) => ["*", ...names(net.places)],
  robots: ({ plan: { robots = {} } }) =>
    Array.isArray(robots) ? names(robots) : Object.keys(robots),
  resources: ({ plan }) => [...(plan.resource_places ?? [])].sort(natural),
  actionPlaces({ net, plan }) {
    const resources = new Set(plan.resource_places);
    return names(net.places).filter((name) => !resources.has(name));
  },
  transitions: ({ net }) => names(net.transitions),
  timed: ({ net }) => names(net.transitions.filter(({ timed }) => timed)),
  immediate: ({ net }) => names(net.transitions.filter(({ timed }) => !timed)),
  leaving: ({ net }, place) =>
    [
      ...new Set(
        net.arcs.filter(({ from, inhibitor }) => from === place && !inhibitor).map(({ to }) => to),
      ),
    ].sort(natural),
};
