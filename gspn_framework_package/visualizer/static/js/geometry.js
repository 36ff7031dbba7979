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

const inside = (node, x, y) => {
  const dx = Math.abs(x - node.x),
    dy = Math.abs(y - node.y);
  if (node.kind === "place") return dx * dx + dy * dy < RADIUS * RADIUS;
  const [w, h] = BAR[node.kind];
  return dx < w && dy < h;
};

function cubicAt(c, t) {
  const u = 1 - t;
  const a = u * u * u,
    b = 3 * u * u * t,
    d = 3 * u * t * t,
    e = t * t * t;
  return [a * c[0] + b * c[2] + d * c[4] + e * c[6], a * c[1] + b * c[3] + d * c[5] + e * c[7]];
}

/** The part of a cubic from t0 to t1. */
function cubicPart(c, t0, t1) {
  const at = (t) => cubicAt(c, t);
  const slope = (t) => {
    const u = 1 - t;
    return [0, 1].map(
      (i) =>
        3 *
        (u * u * (c[2 + i] - c[i]) +
          2 * u * t * (c[4 + i] - c[2 + i]) +
          t * t * (c[6 + i] - c[4 + i])),
    );
  };
  const [p, q, dp, dq] = [at(t0), at(t1), slope(t0), slope(t1)];
  const k = (t1 - t0) / 3;
  return [
    p[0],
    p[1],
    p[0] + dp[0] * k,
    p[1] + dp[1] * k,
    q[0] - dq[0] * k,
    q[1] - dq[1] * k,
    q[0],
    q[1],
  ];
}

const STEPS = 40;

/** The point where a chain of cubics leaves the symbol `node` (from the front) or enters it (from the back). */
function crossing(cubics, node, fromBack) {
  for (let i = 0; i < cubics.length; i++) {
    const index = fromBack ? cubics.length - 1 - i : i;
    for (let step = 0; step <= STEPS; step++) {
      const t = fromBack ? 1 - step / STEPS : step / STEPS;
      const [x, y] = cubicAt(cubics[index], t);
      if (!inside(node, x, y)) {
        let low = fromBack ? Math.min(1, t + 1 / STEPS) : Math.max(0, t - 1 / STEPS);
        let high = t;
        for (let k = 0; k < 8; k++) {
          const middle = (low + high) / 2;
          if (inside(node, ...cubicAt(cubics[index], middle))) low = middle;
          else high = middle;
        }
        return [index, high];
      }
    }
  }
  return null;
}

const r = (value) => Math.round(value * 10) / 10;

/** The shape of one arc. `route`: control points from centre to centre (flat list), or null for a straight or bent
 * line. Returns {start, body, tip, direction, middle, points}: points are [x, y]; body(x, y) is the SVG path text from
 * the start to (x, y), direction the unit vector at the tip, points a sample of the line. */
export function arcShape(from, to, route, bend) {
  if (route && route.length >= 8) {
    const shape = routed(from, to, route);
    if (shape) return shape;
  }
  const dx = to.x - from.x,
    dy = to.y - from.y;
  const length = Math.hypot(dx, dy) || 1;
  const [ux, uy] = [dx / length, dy / length];
  if (!bend) {
    const a = reach(from, dx, dy),
      b = reach(to, dx, dy) + 1;
    const x1 = from.x + ux * a,
      y1 = from.y + uy * a,
      x2 = to.x - ux * b,
      y2 = to.y - uy * b;
    return {
      start: [r(x1), r(y1)],
      body: (bx, by) => `L${r(bx)} ${r(by)}`,
      tip: [x2, y2],
      direction: [ux, uy],
      middle: [(x1 + x2) / 2, (y1 + y2) / 2],
      points: [
        [x1, y1],
        [x2, y2],
      ],
    };
  }
  const mx = (from.x + to.x) / 2 - uy * bend,
    my = (from.y + to.y) / 2 + ux * bend;
  const a = reach(from, mx - from.x, my - from.y),
    b = reach(to, to.x - mx, to.y - my) + 1;
  const la = Math.hypot(mx - from.x, my - from.y) || 1,
    lb = Math.hypot(to.x - mx, to.y - my) || 1;
  const x1 = from.x + ((mx - from.x) / la) * a,
    y1 = from.y + ((my - from.y) / la) * a;
  const [vx, vy] = [(to.x - mx) / lb, (to.y - my) / lb];
  const x2 = to.x - vx * b,
    y2 = to.y - vy * b;
  return {
    start: [r(x1), r(y1)],
    body: (bx, by) => `Q${r(mx)} ${r(my)} ${r(bx)} ${r(by)}`,
    tip: [x2, y2],
    direction: [vx, vy],
    middle: [(x1 + 2 * mx + x2) / 4, (y1 + 2 * my + y2) / 4],
    points: [
      [x1, y1],
      [(x1 + 2 * mx + x2) / 4, (y1 + 2 * my + y2) / 4],
      [x2, y2],
    ],
  };
}

function routed(from, to, route) {
  const cubics = [];
  for (let i = 0; i + 7 < route.length; i += 6) cubics.push(route.slice(i, i + 8));
  const begin = crossing(cubics, from, false),
    end = crossing(cubics, to, true);
  if (!begin || !end || begin[0] > end[0] || (begin[0] === end[0] && begin[1] >= end[1]))
    return null;
  const parts = [];
  for (let i = begin[0]; i <= end[0]; i++) {
    parts.push(cubicPart(cubics[i], i === begin[0] ? begin[1] : 0, i === end[0] ? end[1] : 1));
  }
  const last = parts[parts.length - 1];
  let dx = last[6] - last[4],
    dy = last[7] - last[5];
  if (Math.hypot(dx, dy) < 0.5) [dx, dy] = [last[6] - last[2], last[7] - last[3]];
  const length = Math.hypot(dx, dy) || 1;
  const middle = parts[Math.floor((parts.length - 1) / 2)];
  return {
    start: [r(parts[0][0]), r(parts[0][1])],
    body: (bx, by) =>
      parts
        .map((c, i) => {
          const tail = i === parts.length - 1 ? `${r(bx)} ${r(by)}` : `${r(c[6])} ${r(c[7])}`;
          return `C${r(c[2])} ${r(c[3])} ${r(c[4])} ${r(c[5])} ${tail}`;
        })
        .join(""),
    tip: [last[6], last[7]],
    direction: [dx / length, dy / length],
    middle: cubicAt(middle, 0.5),
    points: parts.flatMap((c) => [0, 0.25, 0.5, 0.75, 1].map((t) => cubicAt(c, t))),
  };
}

const HEAD = 7.5;

/** SVG path text of the line of an arc. */
export function arcLine(shape, inhibitor) {
  const [x, y] = shape.tip,
    [ux, uy] = shape.direction;
  const gap = inhibitor ? 7 : HEAD - 1;
  return `M${shape.start[0]} ${shape.start[1]}${shape.body(x - ux * gap, y - uy * gap)}`;
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

/** Centres and radius of `count` (1 to 9) robots in a place; `square`: rounded squares in rows, which gives each
 * number as much space as possible. */
export function discs(count) {
  if (count === 1) return { radius: 12.5, centres: [[0, 0]] };
  if (count === 2)
    return {
      radius: 8.6,
      centres: [
        [-9, 0],
        [9, 0],
      ],
    };
  if (count === 3)
    return {
      radius: 7.8,
      centres: [
        [0, -9.2],
        [-8.3, 5.4],
        [8.3, 5.4],
      ],
    };
  if (count === 4)
    return {
      radius: 7.4,
      centres: [
        [-7.8, -7.8],
        [7.8, -7.8],
        [-7.8, 7.8],
        [7.8, 7.8],
      ],
    };
  const radius = 6.6,
    step = 2 * radius + 0.8;
  const rows =
    count === 5
      ? [2, 3]
      : count === 6
        ? [3, 3]
        : count === 7
          ? [2, 3, 2]
          : count === 8
            ? [3, 2, 3]
            : [3, 3, 3];
  const centres = rows.flatMap((across, row) =>
    Array.from({ length: across }, (_, i) => [
      (i - (across - 1) / 2) * step,
      (row - (rows.length - 1) / 2) * step,
    ]),
  );
  return { radius, centres, square: true };
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
