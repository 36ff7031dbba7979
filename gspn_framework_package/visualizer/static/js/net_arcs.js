// The arcs of the net: all arcs of one kind form a single path, which is fast to draw.

import { s } from "./dom.js";
import { arcShape, arcLine, arcEnd } from "./geometry.js";

const KINDS = {
  lines: "lines",
  inhibitor: "lines inhibitor",
  near: "lines near",
  heads: "heads",
  circles: "circles",
};
export const SIZES = [1, 1.5, 2, 3, 4]; // scale factors of arrowheads, which keep them visible when zoomed out
const MEETS = 3; // px by which a route may miss the centre of a node
export const BEND = 16; // px by which two arcs between the same nodes bend apart

/** A route from the server, if it connects the ends of an arc, possibly after both were shifted by the same amount. */
function routeBetween({ from, to }, route) {
  if (!route) return null;
  const [dx, dy] = [from.x - route[0], from.y - route[1]];
  const [ex, ey] = [to.x - route.at(-2), to.y - route.at(-1)];
  if (Math.hypot(ex - dx, ey - dy) > MEETS) return null;
  if (Math.hypot(dx, dy) <= MEETS) return route;
  return route.map((value, i) => value + (i % 2 ? dy : dx));
}

export class Arcs {
  /** `places` and `transitions`: the nodes, by index. */
  constructor(scene, places, transitions) {
    this.layer = s("g");
    this.path = {};
    for (const [name, kind] of Object.entries(KINDS)) {
      this.path[name] = s("path", { class: kind });
      this.layer.append(this.path[name]);
    }
    this.weights = s("g");
    this.layer.append(this.weights);
    this.near = null;
    this.size = 1;
    const seen = new Set(scene.arcs.map(([p, t, forth]) => `${p},${t},${forth}`));
    this.all = scene.arcs.map(([p, t, forth, weight, inhibitor], index) => ({
      index,
      weight,
      inhibitor,
      from: forth ? places[p] : transitions[t],
      to: forth ? transitions[t] : places[p],
      both: seen.has(`${p},${t},${1 - forth}`),
    }));
  }

  /** Compute the shapes of all arcs, or of one node's. `routes`: the server's, for nodes at the positions it chose. */
  route(routes, only = null) {
    for (const arc of this.all) {
      if (only && arc.from !== only && arc.to !== only) continue;
      arc.hidden = Boolean(arc.from.folded) && arc.from.folded === arc.to.folded;
      const route = routeBetween(arc, routes[arc.index]);
      arc.shape = arcShape(arc.from, arc.to, route, arc.both ? BEND : 0);
      arc.line = arcLine(arc.shape, arc.inhibitor);
      Object.assign(arc, { middle: arc.shape.middle, points: arc.shape.points });
    }
    this.path.lines.setAttribute(
      "d",
      this.join((a) => !a.inhibitor && a.line),
    );
    this.path.inhibitor.setAttribute(
      "d",
      this.join((a) => a.inhibitor && a.line),
    );
    this.drawEnds();
    this.weights.replaceChildren(
      ...this.all
        .filter((a) => a.weight > 1 && !a.hidden)
        .map((a) => s("text", { x: a.middle[0], y: a.middle[1], text: String(a.weight) })),
    );
    this.showNear(this.near);
  }

  join(pick) {
    return this.all
      .filter((arc) => !arc.hidden)
      .map(pick)
      .filter(Boolean)
      .join("");
  }

  drawEnds() {
    this.path.heads.setAttribute(
      "d",
      this.join((a) => !a.inhibitor && arcEnd(a.shape, false, this.size)),
    );
    this.path.circles.setAttribute(
      "d",
      this.join((a) => a.inhibitor && arcEnd(a.shape, true, this.size)),
    );
  }

  /** Adapt to zoom `k`: zoomed out, arrowheads are drawn larger, in a few steps. */
  zoomed(k) {
    const size = SIZES.find((factor) => factor * k >= 0.7) || SIZES[SIZES.length - 1];
    if (size === this.size) return;
    this.size = size;
    this.drawEnds();
  }

  /** Highlight the arcs of the selected node; null: of none. */
  showNear(node) {
    this.near = node;
    const near = node
      ? this.all.filter((a) => (a.from === node || a.to === node) && !a.inhibitor && !a.hidden)
      : [];
    this.path.near.setAttribute("d", near.map((a) => a.line).join(""));
  }
}
