// The geometry of arcs. Symbols: a place is a circle, a transition an upright bar or box.

export const RADIUS = 20;
export const BAR = { immediate: [4, 18], timed: [9, 18] };

/** Distance from the centre of a symbol to its edge in the direction (dx, dy). */
function reach(node, dx, dy) {
  if (node.kind === "place") return RADIUS;
  if (!dx && !dy) return 0; // the symbols overlap
  const [w, h] = BAR[node.kind];
  const length = Math.hypot(dx, dy) || 1;
  return Math.min(
    dx ? (w * length) / Math.abs(dx) : Infinity,
    dy ? (h * length) / Math.abs(dy) : Infinity,
  );
}

const CORNER = 14; // px of an arc before and after a bend that are round

const r = (value) => Math.round(value * 10) / 10;

/** How far aside (px) an arc with two bends is at the part `t` of its way. */
export const asideAt = ([first, second], t) => 3 * t * (1 - t) * ((1 - t) * first + t * second);

/** Where an arc that comes from the point [x, y] ends, `gap` px from the edge of a symbol: {at, way}, way is the unit
 * vector to there from the centre. */
function edge(node, [x, y], gap) {
  const [ex, ey] = [x - node.x, y - node.y];
  const far = Math.hypot(ex, ey) || 1;
  const way = [ex / far, ey / far];
  const out = reach(node, ex, ey) + gap;
  return { way, at: [node.x + way[0] * out, node.y + way[1] * out] };
}

/** The line of an arc through `bends` (px), with round corners; otherwise as below, with `corners` [[before, bend,
 * after], ...] instead of controls. */
export function bentShape(from, to, bends) {
  const [begin, end] = [edge(from, bends[0], 0), edge(to, bends.at(-1), 1)];
  const stops = [begin.at, ...bends, end.at];
  const toward = ([ax, ay], [bx, by]) => {
    const length = Math.hypot(bx - ax, by - ay) || 1;
    const part = Math.min(CORNER, length / 2) / length;
    return [ax + (bx - ax) * part, ay + (by - ay) * part];
  };
  const corners = bends.map((bend, i) => [
    toward(bend, stops[i]),
    bend,
    toward(bend, stops[i + 2]),
  ]);
  const round = ([[ax, ay], [bx, by], [cx, cy]]) => [
    (ax + 2 * bx + cx) / 4,
    (ay + 2 * by + cy) / 4,
  ];
  const points = [begin.at, ...corners.flatMap((c) => [c[0], round(c), c[2]]), end.at];
  return {
    start: begin.at,
    corners,
    tip: end.at,
    direction: end.way.map((value) => -value),
    middle: halfway(points),
    points,
  };
}

/** Distance of a point from a line between two points. */
export function distance([px, py], [ax, ay], [bx, by]) {
  const [dx, dy] = [bx - ax, by - ay];
  const t = Math.max(0, Math.min(1, ((px - ax) * dx + (py - ay) * dy) / (dx * dx + dy * dy || 1)));
  return Math.hypot(px - ax - t * dx, py - ay - t * dy);
}

/** The lengths of a line up to each of its points. */
export function lengths(points) {
  let sum = 0;
  return points.map(([x, y], i) => {
    if (i) sum += Math.hypot(x - points[i - 1][0], y - points[i - 1][1]);
    return sum;
  });
}

function halfway(points) {
  const far = lengths(points);
  const half = far.at(-1) / 2;
  const i = Math.max(
    1,
    far.findIndex((length) => length >= half),
  );
  const part = (half - far[i - 1]) / (far[i] - far[i - 1] || 1);
  return [0, 1].map((axis) => points[i - 1][axis] + part * (points[i][axis] - points[i - 1][axis]));
}

/** The curve of an arc from edge to edge. `bends`: how far its control points, at a third and at two thirds of its way,
 * are from the straight line (px). Returns {start, controls, tip, direction, middle, points}: direction is the unit
 * vector at the tip, points a sample of the line. */
export function arcShape(from, to, bends) {
  const [dx, dy] = [to.x - from.x, to.y - from.y];
  const length = Math.hypot(dx, dy) || 1;
  const beside = (part, aside) => [
    from.x + part * dx - (aside * dy) / length,
    from.y + part * dy + (aside * dx) / length,
  ];
  const [first, second] = bends.map((bend, i) => beside((i + 1) / 3, bend));
  const [begin, end] = [edge(from, first, 0), edge(to, second, 1)];
  const straight = bends.every((bend) => !bend);
  const steps = straight ? 0 : 3 + Math.ceil(Math.max(...bends.map(Math.abs)) / 12);
  const between = Array.from({ length: steps }, (_, i) => (i + 1) / (steps + 1));
  return {
    start: begin.at,
    controls: straight ? [] : [first, second],
    tip: end.at,
    direction: end.way.map((value) => -value),
    middle: beside(0.5, asideAt(bends, 0.5)),
    points: [begin.at, ...between.map((t) => beside(t, asideAt(bends, t))), end.at],
  };
}

const HEAD = 7.5;

/** SVG path text of the line of an arc. */
export function arcLine(shape, inhibitor) {
  const [x, y] = shape.tip,
    [ux, uy] = shape.direction;
  const gap = inhibitor ? 7 : HEAD - 1;
  const end = [x - ux * gap, y - uy * gap];
  const text = (...points) => points.flatMap((point) => point.map(r)).join(" ");
  if (shape.corners) {
    const turns = shape.corners.map(([before, ...turn]) => `L${text(before)}Q${text(...turn)}`);
    return `M${text(shape.start)}${turns.join("")}L${text(end)}`;
  }
  return `M${text(shape.start)}${shape.controls.length ? "C" : "L"}${text(...shape.controls, end)}`;
}

/** SVG path text of the end of an arc, an arrowhead or a small circle, `size` times as large as usual. */
export function arcEnd({ tip: [x, y], direction: [ux, uy], points }, inhibitor, size = 1) {
  const [fx, fy] = points[0];
  // at most half of a short arc
  const scale = Math.min(size, Math.max(1, (Math.hypot(x - fx, y - fy) * 0.5) / HEAD));
  if (inhibitor) {
    const radius = 3.5 * scale,
      cx = r(x - ux * (radius + 0.5)),
      cy = r(y - uy * (radius + 0.5));
    const half = (length) => `a${r(radius)} ${r(radius)} 0 1 0 ${r(length)} 0`;
    return `M${r(cx - radius)} ${cy}${half(2 * radius)}${half(-2 * radius)}`;
  }
  const length = HEAD * scale,
    w = 3.3 * scale;
  const bx = x - ux * length,
    by = y - uy * length;
  return `M${r(x)} ${r(y)}L${r(bx - uy * w)} ${r(by + ux * w)}L${r(bx + uy * w)} ${r(by - ux * w)}Z`;
}

/** Centres of `count` (1 to 9) tokens in a place, arranged as on dice. */
export function dots(count) {
  const d = 8.2;
  const grid = (...cells) =>
    cells.map((cell) => [((cell % 3) - 1) * d, (Math.floor(cell / 3) - 1) * d]);
  const patterns = [
    [],
    grid(4),
    grid(3, 5),
    [
      [0, -d * 0.7],
      [-d * 0.75, d * 0.6],
      [d * 0.75, d * 0.6],
    ],
    grid(0, 2, 6, 8).map(([x, y]) => [x * 0.8, y * 0.8]),
    grid(0, 2, 4, 6, 8),
    grid(0, 2, 3, 5, 6, 8),
    grid(0, 2, 3, 4, 5, 6, 8),
    grid(0, 1, 2, 3, 5, 6, 7, 8),
    grid(0, 1, 2, 3, 4, 5, 6, 7, 8),
  ];
  return patterns[count];
}

const ROWS = ["", "1", "2", "", "22", "23", "33", "232", "323", "333"]; // robots in each row, by their number
const FEW = { 1: [12.5, 0], 2: [8.6, 18], 4: [7.4, 15.6] }; // radius and distance of up to four

/** Centres and radius of `count` (1 to 9) robots in a place; `square`: rounded squares in rows, which gives each
 * number as much space as possible. */
export function discs(count) {
  const triangle = [
    [0, -9.2],
    [-8.3, 5.4],
    [8.3, 5.4],
  ];
  if (count === 3) return { radius: 7.8, centres: triangle };
  const [radius, step] = FEW[count] || [6.6, 14];
  const rows = [...ROWS[count]].map(Number);
  const centres = rows.flatMap((across, row) =>
    Array.from({ length: across }, (_, i) => [
      (i - (across - 1) / 2) * step,
      (row - (rows.length - 1) / 2) * step,
    ]),
  );
  return { radius, centres, square: count > 4 };
}

/** Begin a path on a canvas through these points. */
export function trace(canvas, points) {
  canvas.beginPath();
  for (const [x, y] of points) canvas.lineTo(x, y);
}
