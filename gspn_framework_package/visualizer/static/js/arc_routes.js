// The courses of arcs, the same in all modes and in pictures: an arc runs through the bends that a person drew, or else
// is straight, or bends around the nodes that it would run through. Courses depend on where the nodes are, and on
// nothing that happened before.

import { RADIUS, BAR, arcShape, asideAt, bentShape } from "./geometry.js";

const APART = 10; // px by which the bends of two arcs between the same nodes are apart
const MOST = 180; // px that an arc may bend aside
const WIDEST = 4; // how many times as far a long arc may bend aside
const MOST_STEEP = 0.75; // of its length
const SIDES = [0, 36, 72, 120, MOST].flatMap((bend) => (bend ? [bend, -bend] : [0]));
const size = ([first, second]) => Math.abs(first) + Math.abs(second) + Math.abs(first - second) / 2;
/** The bends that are tried, the slightest first. */
const BENDS = SIDES.flatMap((first) => SIDES.map((second) => [first, second])).sort(
  (a, b) => size(a) - size(b),
);
const CLEAR = 5; // px between an arc and the symbols beside it
const REACH = RADIUS + CLEAR;
const CELL = 64;
const HOPELESS = 6; // an arc through more nodes stays straight: it has no way around them
const FEW = 60; // if up to this many nodes have moved, only the arcs near them get another course
const NOTHING = [];

const cell = (x, y) => Math.floor(x / CELL) * 100003 + Math.floor(y / CELL);

const covers = ({ kind, x, y }, px, py) => {
  const [dx, dy] = [Math.abs(px - x), Math.abs(py - y)];
  if (kind === "place") return Math.hypot(dx, dy) < RADIUS + CLEAR;
  const [w, h] = BAR[kind];
  return dx < w + CLEAR && dy < h + CLEAR;
};

/** The strip of `reach` px on both sides of the straight line of an arc. */
const wayOf = ({ from: { x, y }, to }, length, reach) => ({
  x,
  y,
  ux: (to.x - x) / length,
  uy: (to.y - y) / length,
  length,
  reach,
});

/** Where a spot is in the strip of an arc: how far (px) along it and aside. */
const inStrip = (spot, { x, y, ux, uy }) => {
  const [dx, dy] = [spot.x - x, spot.y - y];
  return [dx * ux + dy * uy, dy * ux - dx * uy];
};

function isBeside(spot, way) {
  const [along, aside] = inStrip(spot, way);
  return Math.abs(aside) <= way.reach && along >= -way.reach && along <= way.length + way.reach;
}

/** Where the bends of an arc are (px). */
export const bendsOf = ({ from, to, bends }) =>
  (bends || NOTHING).map(([x, y]) => [x + (from.x + to.x) / 2, y + (from.y + to.y) / 2]);

/** The box around nodes and the bends of arcs, [left, top, right, bottom]: `margin` wider than these, at the top
 * `above`; null without nodes. */
export function boundsOf(nodes, arcs, margin, above) {
  if (!nodes.length) return null;
  let [x0, y0, x1, y1] = [Infinity, Infinity, -Infinity, -Infinity];
  for (const [x, y] of [...nodes.map((node) => [node.x, node.y]), ...arcs.flatMap(bendsOf)]) {
    x0 = Math.min(x0, x);
    y0 = Math.min(y0, y);
    x1 = Math.max(x1, x);
    y1 = Math.max(y1, y);
  }
  return [x0 - margin, y0 - above, x1 + margin, y1 + margin];
}

/** Through how many nodes an arc runs if it bends like that, up to `most`. */
function through({ from, to }, bends, length, near, most) {
  const [dx, dy] = [to.x - from.x, to.y - from.y];
  const steep = (3 * Math.max(...bends.map(Math.abs))) / length;
  let count = 0;
  for (const { node, part, aside } of near) {
    if (Math.abs(asideAt(bends, part) - aside) > REACH * (1 + steep)) continue;
    for (let i = -2; i <= 2; i++) {
      const t = part + (i * REACH) / 2 / length;
      const away = asideAt(bends, t) / length;
      if (t <= 0 || t >= 1) continue;
      if (!covers(node, from.x + t * dx - away * dy, from.y + t * dy + away * dx)) continue;
      count += 1;
      break;
    }
    if (count >= most) break;
  }
  return count;
}

export class ArcRoutes {
  constructor() {
    this.spots = new Map(); // node -> {x, y, kind, cells}, as last seen
    this.cells = new Map(); // cell -> the nodes in it
  }

  /** Give arcs ({from, to, bends, both, stale}) their `shape` for the nodes that are drawn now. `bends`: those that
   * were drawn, from the middle between the ends, so that they move with these (px); `both`: there is an arc the other
   * way, too; `stale`: it is to be routed in any case. Returns the arcs that were routed. */
  route(nodes, arcs) {
    const moved = this.see(nodes);
    const near = ({ way }) => moved.some((spot) => isBeside(spot, way));
    const routed = arcs.filter((arc) => arc.stale || moved.length > FEW || near(arc));
    for (const arc of routed) this.shape(arc);
    return routed;
  }

  /** Note where the nodes are. Returns the spots that nodes have left or come to. */
  see(nodes) {
    const moved = [];
    const here = new Set(nodes);
    for (const [node, spot] of this.spots) {
      const stays = here.has(node) && spot.x === node.x && spot.y === node.y;
      if (stays && spot.kind === node.kind) continue;
      for (const key of spot.cells) this.cells.get(key).delete(node);
      this.spots.delete(node);
      moved.push(spot);
    }
    for (const node of nodes) {
      if (this.spots.has(node)) continue;
      const { x, y, kind } = node;
      const ends = [-REACH, REACH];
      const cells = new Set(ends.flatMap((dx) => ends.map((dy) => cell(x + dx, y + dy))));
      for (const key of cells) {
        if (!this.cells.has(key)) this.cells.set(key, new Set());
        this.cells.get(key).add(node);
      }
      this.spots.set(node, { x, y, kind, cells });
      moved.push(node);
    }
    return moved;
  }

  shape(arc) {
    const { from, to } = arc;
    const length = Math.hypot(to.x - from.x, to.y - from.y) || 1;
    if (arc.bends) {
      arc.shape = bentShape(from, to, bendsOf(arc));
      arc.stale = false;
      arc.way = wayOf(arc, length, REACH);
      return;
    }
    const own = arc.both ? APART : 0;
    let best = [own, own];
    let tried = own;
    let least = through(arc, best, length, this.beside(arc, length, REACH + own), HOPELESS);
    if (least && least < HOPELESS) {
      const wide = Math.min(WIDEST, Math.max(1, length / 500));
      const near = this.beside(arc, length, wide * MOST + own + REACH);
      for (const bends of BENDS) {
        const bent = bends.map((bend) => wide * bend + own);
        const aside = Math.max(...bent.map(Math.abs));
        if (aside > MOST_STEEP * length) continue;
        tried = Math.max(tried, aside);
        const count = through(arc, bent, length, near, least);
        if (count < least) [best, least] = [bent, count];
        if (!least) break;
      }
    }
    arc.shape = arcShape(from, to, best);
    arc.stale = false;
    arc.way = wayOf(arc, length, tried + REACH); // nodes elsewhere do not matter
  }

  /** The nodes in the strip of an arc: at which part of its way they are, and how far (px) aside. */
  beside(arc, length, reach) {
    const way = wayOf(arc, length, reach);
    const found = new Set([arc.from, arc.to]);
    const near = [];
    const rows = Math.ceil(reach / CELL);
    for (let along = 0; along <= length + CELL / 2; along += CELL / 2)
      for (let row = -rows; row <= rows; row++) {
        const [x, y] = [along * way.ux - row * CELL * way.uy, along * way.uy + row * CELL * way.ux];
        for (const node of this.cells.get(cell(way.x + x, way.y + y)) || NOTHING) {
          if (found.has(node)) continue;
          found.add(node);
          const [at, aside] = inStrip(node, way);
          near.push({ node, part: at / length, aside });
        }
      }
    return near;
  }
}
