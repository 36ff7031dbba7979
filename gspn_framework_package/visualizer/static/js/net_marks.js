// Results on the net: links to its nodes, and marks on them with a legend.

import { $, h } from "./dom.js";

/** A link to a node of a scene, which calls `choose({kind, index, fly})`; its name if there is no such node. */
export function nodeLink({ places, transitions }, name, choose) {
  for (const [kind, nodes] of Object.entries({ place: places, transition: transitions })) {
    const index = nodes.findIndex((node) => node.name === name);
    const onclick = () => choose({ kind, index, fly: true });
    if (index >= 0) return h("button.link", { text: name, onclick });
  }
  return name;
}

/** Mark nodes, and only these. `marks`: [[name of a node, mark], ...] (paintNode describes a mark); `legend`: what
 * explains them. */
export function mark(view, marks, ...legend) {
  view.paint(new Map(marks));
  const onclick = () => unmark(view);
  $("legend").replaceChildren(
    ...legend,
    h("button.icon.small", { "aria-label": "Clear highlighting", text: "×", onclick }),
  );
  $("legend").hidden = false;
}

export function unmark(view) {
  view.paint(null);
  $("legend").hidden = true;
}
