// The arcs of the net: all arcs of one kind form a single path, which is fast to draw.

import { s } from "./dom.js";
import { ArcRoutes } from "./arc_routes.js";
import { arcLine, arcEnd } from "./geometry.js";

const KINDS = {
  lines: "lines",
  inhibitor: "lines inhibitor",
  near: "lines near",
  heads: "heads",
  circles: "circles",
};
const SIZES = [1, 1.5, 2, 3, 4]; // scale factors of arrowheads, which keep them visible when zoomed out

/** The scale factor of arrowheads at zoom `k`. */
export const sizeAt = (k) => SIZES.find((factor) => factor * k >= 0.7) || SIZES.at(-1);

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
    this.routes = new ArcRoutes();
    const seen = new Set(scene.arcs.map(([p, t, forth]) => `${p},${t},${forth}`));
    this.all = scene.arcs.map(([p, t, forth, weight, inhibitor]) => ({
      weight,
      inhibitor,
      from: forth ? places[p] : transitions[t],
      to: forth ? transitions[t] : places[p],
      both: seen.has(`${p},${t},${1 - forth}`),
    }));
    this.bend(scene.layout.bends);
  }

  /** Use the bends that belong to a layout: number of an arc -> bends. */
  bend(bends = {}) {
    this.all.forEach((arc, i) => Object.assign(arc, { drawn: bends[i], stale: true }));
  }

  /** Draw the arcs between the nodes as they are now. */
  route(nodes) {
    for (const arc of this.all) {
      const { from, to, drawn } = arc;
      arc.hidden = Boolean(from.folded) && from.folded === to.folded;
      const away = [from, to].some((node) => node.folded && node.folded !== node);
      const bends = away ? undefined : drawn;
      if (arc.bends !== bends) Object.assign(arc, { bends, stale: true });
    }
    const drawn = nodes.filter((node) => !node.folded || node.folded === node);
    for (const arc of this.routes.route(drawn, this.all))
      arc.line = arcLine(arc.shape, arc.inhibitor);
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
        .map(({ shape: { middle }, weight }) =>
          s("text", { x: middle[0], y: middle[1], text: String(weight) }),
        ),
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
    if (sizeAt(k) === this.size) return;
    this.size = sizeAt(k);
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
