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

const r = (value) => Math.round(value * 10) / 10;

/** How far aside (px) an arc with two bends is at the part `t` of its way. */
export const asideAt = ([first, second], t) => 3 * t * (1 - t) * ((1 - t) * first + t * second);

/** The curve of an arc from edge to edge. `bends`: how far its control points, at a third and at two thirds of its way,
 * are aside of the straight line (px). Returns {start, controls, tip, direction, middle, points}: direction is the unit
 * vector at the tip, points a sample of the line. */
export function arcShape(from, to, bends) {
  const [dx, dy] = [to.x - from.x, to.y - from.y];
  const length = Math.hypot(dx, dy) || 1;
  const beside = (part, aside) => [
    from.x + part * dx - (aside * dy) / length,
    from.y + part * dy + (aside * dx) / length,
  ];
  const [first, second] = bends.map((bend, i) => beside((i + 1) / 3, bend));
  const edge = (node, [x, y], gap) => {
    const [ex, ey] = [x - node.x, y - node.y];
    const far = Math.hypot(ex, ey) || 1;
    const way = [ex / far, ey / far];
    const out = reach(node, ex, ey) + gap;
    return { way, at: [node.x + way[0] * out, node.y + way[1] * out] };
  };
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
  const points = [shape.start, ...shape.controls, [x - ux * gap, y - uy * gap]];
  const [from, ...rest] = points.map((point) => point.map(r).join(" "));
  return `M${from}${rest.length > 1 ? "C" : "L"}${rest.join(" ")}`;
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

/** The box around nodes, [left, top, right, bottom]: `margin` wider than their centres, at the top `above`; null
 * without nodes. */
export function boundsOf(nodes, margin, above) {
  if (!nodes.length) return null;
  let [x0, y0, x1, y1] = [Infinity, Infinity, -Infinity, -Infinity];
  for (const { x, y } of nodes) {
    x0 = Math.min(x0, x);
    y0 = Math.min(y0, y);
    x1 = Math.max(x1, x);
    y1 = Math.max(y1, y);
  }
  return [x0 - margin, y0 - above, x1 + margin, y1 + margin];
}

/** Begin a path on a canvas through these points. */
export function trace(canvas, points) {
  canvas.beginPath();
  for (const [x, y] of points) canvas.lineTo(x, y);
}
