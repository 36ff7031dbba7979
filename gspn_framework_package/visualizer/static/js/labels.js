// Names next to the nodes, readable at every zoom; names that would cover something are left out. The selected node is
// always named; if space is short, nodes with tokens and enabled transitions take precedence.

import { s } from "./dom.js";
import { RADIUS, BAR } from "./geometry.js";

const CHARACTERS = 24;
const FONT = 11;
const FAMILY = 'system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif';
const BOLD = 1.12; // relative width of the selected node's name
const SMALLEST = 9.5; // px
const CROWDED = 0.28; // below this zoom, only the most important names are shown
const TINY = 0.1; // below this one, only that of the selected node
const FEW = 120;
const FOLLOW = 400; // ms between two updates of names after tokens have moved
const DRAWN = 700; // largest number of names drawn
const CELL = 64;
const ARCS = 1500; // names avoid arcs in nets with up to this many arcs
const THOROUGH = 250; // with up to this many nodes in view, every spot is tried
const PUZZLED = 120; // with up to this many, names move to make room for others
const SLIDES = [0, -0.33, 0.33, -0.66, 0.66, -1, 1]; // offsets of a name along its symbol, from the middle
const GAP = 3; // px between a symbol and its name
const FLAG = 11; // height of the triangle above an enabled transition, in units of the net

const shorten = (name) => {
  const characters = [...name];
  return characters.length > CHARACTERS ? `${characters.slice(0, CHARACTERS - 1).join("")}…` : name;
};

const NOTHING = [];
const apart = (a, b) => a[0] >= b[2] || a[2] <= b[0] || a[1] >= b[3] || a[3] <= b[1];

/** Boxes [x0, y0, x1, y1] in pixels; a coarse grid finds those nearby. */
class Boxes {
  constructor() {
    this.cells = new Map();
  }

  keys([x0, y0, x1, y1]) {
    const keys = [];
    for (let i = Math.floor(x0 / CELL); i <= Math.floor(x1 / CELL); i++) {
      for (let j = Math.floor(y0 / CELL); j <= Math.floor(y1 / CELL); j++)
        keys.push(i * 100003 + j);
    }
    return keys;
  }

  add(box) {
    for (const key of this.keys(box)) {
      if (!this.cells.has(key)) this.cells.set(key, new Set());
      this.cells.get(key).add(box);
    }
  }

  remove(box) {
    for (const key of this.keys(box)) this.cells.get(key)?.delete(box);
  }

  /** The boxes that a box overlaps. */
  under(box) {
    const found = new Set();
    for (const key of this.keys(box)) {
      for (const other of this.cells.get(key) || NOTHING) if (!apart(box, other)) found.add(other);
    }
    return found;
  }

  free(box) {
    for (const key of this.keys(box)) {
      for (const other of this.cells.get(key) || NOTHING) if (!apart(box, other)) return false;
    }
    return true;
  }
}

export class Labels {
  constructor(view) {
    this.view = view;
    this.few = false; // whether only nodes with tokens and enabled transitions are named
    this.ruler = document.createElement("canvas").getContext("2d");
    this.ruler.font = `100px ${FAMILY}`;
  }

  /** Width of a name at a font size of 1. */
  width(node) {
    if (node.text === undefined) {
      node.text = shorten(node.title || node.name);
      node.textWidth = this.ruler.measureText(node.text).width / 100 + 0.1;
    }
    return node.textWidth;
  }

  later() {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.place(), this.drawn ? 110 : 0);
  }

  /** Place all names at once, for a picture; those of nodes out of view do not stay. */
  placeAll() {
    clearTimeout(this.timer);
    this.place(true);
    this.later();
  }

  /** Tokens have moved: if only nodes with tokens are named, update the names occasionally. */
  follow() {
    if (this.few && !this.timer) this.timer = setTimeout(() => this.place(), FOLLOW);
  }

  /** The rank of a name: 0 the selected node, 1 its neighbours, 2 nodes with tokens or enabled, 3 the rest. */
  rank(node) {
    if (node === this.chosen) return 0;
    if (this.beside.has(node)) return 1;
    return (node.kind === "place" ? node.count > 0 || node.robots : node.enabled) ? 2 : 3;
  }

  place(all = false) {
    this.timer = 0;
    const { view } = this;
    if (!view.camera.now || !view.nodes.length) return;
    const { k, x, y } = view.camera.now;
    const { left, top, width, height } = view.container.getBoundingClientRect();
    this.drawn = true;
    const seen = [];
    for (const node of view.nodes) {
      if (node.folded && node.folded !== node) continue; // hidden in a subnet
      const [sx, sy] = [node.x * k + x, node.y * k + y];
      const inView = sx > -60 && sy > -40 && sx < width + 60 && sy < height + 40;
      if (all || inView) seen.push({ node, sx, sy });
      else this.take(node, null);
    }
    const size = Math.max(k, 1) * FONT * Math.min(1, 1.06 - 0.06 / Math.max(k, 0.2)); // on the screen
    const shown = Math.max(SMALLEST, size);

    this.chosen = view.selection && view.nodeOf(view.selection);
    this.beside = new Set(
      this.chosen
        ? view.arcs.all.flatMap(({ from, to }) =>
            from === this.chosen ? [to] : to === this.chosen ? [from] : [],
          )
        : [],
    );
    const crowded = (this.few = !all && k < CROWDED);
    const least = crowded ? (k < TINY ? 1 : 2) : 3; // highest rank that is named at this zoom
    const order = [];
    for (const item of seen) {
      const rank = this.rank(item.node);
      if (rank <= least) order.push({ ...item, rank });
      else this.take(item.node, null);
    }
    if (!order.length) return;
    this.k = k;
    this.shown = shown;
    this.line = shown * 1.25;
    this.room = all ? [-Infinity, -Infinity, Infinity, Infinity] : [2, 2, width - 2, height - 2];
    this.fixed = new Boxes();
    this.names = new Boxes();
    this.placed = new Map(); // item -> box of its name
    this.points = new Map();
    for (const { node, sx, sy } of seen) {
      const [w, h] = node.kind === "place" ? [RADIUS, RADIUS] : BAR[node.kind];
      this.fixed.add([
        sx - w * k,
        sy - (h + (node.kind === "place" ? 0 : FLAG)) * k,
        sx + w * k,
        sy + h * k,
      ]);
      if (node.sign) this.fixed.add([sx + 8 * k, sy - 29 * k, sx + 26 * k, sy - 11 * k]);
    }
    if (view.arcs.all.length <= ARCS) this.sampleArcs(this.points, view.camera.now);
    const { parentElement } = view.container;
    const over = all ? ".boxes text" : ".zoom, .frame-name, .subnets, .boxes text";
    for (const element of parentElement.querySelectorAll(over)) {
      const box = element.getBoundingClientRect();
      this.fixed.add([box.left - left, box.top - top, box.right - left, box.bottom - top]);
    }
    for (const { node, sx } of seen) {
      if (!node.value) continue;
      const half = (node.value.textContent.length * shown * 0.6) / 2,
        base = Number(node.value.getAttribute("y")) * k + y;
      node.value.style.fontSize = `${(shown / k).toFixed(2)}px`;
      this.fixed.add([sx - half, base - this.line * 0.85, sx + half, base + this.line * 0.15]);
    }

    order.sort(
      (a, b) =>
        a.rank - b.rank || (a.node.kind === "place" ? 0 : 1) - (b.node.kind === "place" ? 0 : 1),
    );
    this.thorough = seen.length <= THOROUGH;
    const leftOut = [];
    for (const item of order) {
      if (this.placed.size >= (crowded ? FEW : DRAWN)) break;
      const box = this.bestFree(item) || (item.rank === 0 ? this.leastBad(item) : null);
      if (box) this.settle(item, box);
      else leftOut.push(item);
    }
    if (seen.length <= PUZZLED) for (const item of leftOut) this.makeRoom(item, 3);
    for (const item of order) {
      const box = this.placed.get(item);
      this.take(
        item.node,
        box ? [(box[0] - item.sx) / k, (box[1] + shown * 0.95 - item.sy) / k] : null,
      );
    }
  }

  /** Possible positions of a node's name: boxes, each with a `cost`. Below, above, left and right of the symbol; if few
   * nodes are in view, also shifted along the symbol and farther away. */
  spots({ node, sx, sy }) {
    const { k, line } = this;
    const [halfWidth, halfHeight] = node.kind === "place" ? [RADIUS, RADIUS] : BAR[node.kind];
    const w = halfWidth * k,
      h = halfHeight * k;
    const above = h + (node.kind === "place" ? 0 : FLAG * k);
    const length = this.width(node) * this.shown * (node === this.chosen ? BOLD : 1);
    const found = [];
    const spot = (x0, y0, cost) =>
      found.push(Object.assign([x0, y0, x0 + length, y0 + line], { cost }));
    for (const far of this.thorough ? [0, 0.6, 1.2, 1.8] : [0]) {
      const gap = GAP + far * line;
      for (const slide of this.thorough ? SLIDES : [0]) {
        const cost = far * 24 + Math.abs(slide) * 6;
        const along = sx - length / 2 + (slide * length) / 2,
          up = sy - line / 2 + slide * (h + line / 2);
        spot(along, sy + h + gap, cost);
        spot(along, sy - above - gap - line, cost + 1);
        spot(sx + w + gap + 1, up, cost + 2);
        spot(sx - w - gap - 1 - length, up, cost + 3);
      }
    }
    return found;
  }

  inRoom(box) {
    const [x0, y0, x1, y1] = this.room;
    return box[0] > x0 && box[1] > y0 && box[2] < x1 && box[3] < y1;
  }

  /** The first free spot, preferably one that no arc crosses. */
  bestFree(item) {
    let best = null,
      least = Infinity;
    for (const box of this.spots(item)) {
      if (box.cost >= least || !this.inRoom(box) || !this.fixed.free(box) || !this.names.free(box))
        continue;
      const cost = this.crossed(box) * 2 + box.cost;
      if (cost < least) [best, least] = [box, cost];
    }
    return best;
  }

  /** The number of arc points that a box covers. */
  crossed(box) {
    let count = 0;
    for (const key of this.names.keys(box)) {
      for (const [px, py] of this.points.get(key) || NOTHING) {
        if (px > box[0] - 1 && px < box[2] + 1 && py > box[1] + 1 && py < box[3] - 2) count += 1;
      }
    }
    return count;
  }

  leastBad(item) {
    const spots = this.spots(item);
    const cost = (box) => this.fixed.under(box).size + (this.inRoom(box) ? 0 : 5);
    return spots.reduce((best, box) => (cost(box) < cost(best) ? box : best), spots[0]);
  }

  /** Put a name in the place of others if those can move to another spot, possibly by moving further names. */
  makeRoom(item, depth) {
    const spots = this.spots(item)
      .filter((box) => this.inRoom(box) && this.fixed.free(box))
      .map((box) => [box, [...this.names.under(box)]])
      .filter(
        ([, others]) =>
          others.length <= 2 && others.every((other) => other.item.rank > 0 && !other.held),
      )
      .sort((a, b) => a[1].length - b[1].length || a[0].cost - b[0].cost);
    for (const [box, others] of spots) {
      const before = new Map(this.placed);
      for (const other of others) this.lift(other.item);
      this.settle(item, box);
      box.held = true;
      const fits = others.every((other) => {
        const spot = this.bestFree(other.item);
        if (spot) this.settle(other.item, spot);
        return spot || (depth > 1 && this.makeRoom(other.item, depth - 1));
      });
      box.held = false;
      if (fits) return true;
      for (const moved of [...this.placed.keys()])
        if (before.get(moved) !== this.placed.get(moved)) this.lift(moved);
      for (const [moved, spot] of before) if (!this.placed.has(moved)) this.settle(moved, spot);
    }
    return false;
  }

  settle(item, box) {
    box.item = item;
    this.names.add(box);
    this.placed.set(item, box);
  }

  lift(item) {
    this.names.remove(this.placed.get(item));
    this.placed.delete(item);
  }

  /** Points of the arcs, in pixels, by cell. */
  sampleArcs(lines, { k, x, y }) {
    for (const arc of this.view.arcs.all) {
      for (let i = 1; i < arc.shape.points.length; i++) {
        const [ax, ay] = [arc.shape.points[i - 1][0] * k + x, arc.shape.points[i - 1][1] * k + y];
        const [bx, by] = [arc.shape.points[i][0] * k + x, arc.shape.points[i][1] * k + y];
        const steps = Math.min(200, Math.ceil(Math.hypot(bx - ax, by - ay) / 6));
        for (let j = 0; j <= steps; j++) {
          const px = ax + ((bx - ax) * j) / steps,
            py = ay + ((by - ay) * j) / steps;
          const key = Math.floor(px / CELL) * 100003 + Math.floor(py / CELL);
          if (!lines.has(key)) lines.set(key, []);
          lines.get(key).push([px, py]);
        }
      }
    }
  }

  take(node, spot) {
    if (!spot) {
      if (node.label) {
        node.label.remove();
        node.label = null;
      }
      return;
    }
    if (!node.label) {
      node.label = s("text.label", node.text);
      node.element.append(node.label);
    }
    // not inherited from the drawing: that would compute the style of everything in it again
    node.label.style.fontSize = `${(this.shown / this.k).toFixed(2)}px`;
    node.label.setAttribute("x", (node.base[0] + spot[0]).toFixed(1));
    node.label.setAttribute("y", (node.base[1] + spot[1]).toFixed(1));
  }

  close() {
    clearTimeout(this.timer);
  }
}
