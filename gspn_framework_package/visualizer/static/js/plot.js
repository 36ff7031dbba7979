// Small plots: curves over time, bars.

import { announce, h, s, number, rounded } from "./dom.js";
import { download, pictureOf } from "./edit/picture.js";

export const CURVES = [
  "#2f7fc1",
  "#d1622b",
  "#2a9d63",
  "#9a55c4",
  "#c43b5f",
  "#17899a",
  "#a07a13",
  "#6a66d6",
];

const W = 316,
  H = 170,
  LEFT = 40,
  BOTTOM = 31,
  TOP = 8,
  RIGHT = 8;

function nice(value) {
  if (value <= 0) return 1;
  const power = 10 ** Math.floor(Math.log10(value));
  return [1, 2, 5, 10].map((f) => f * power).find((v) => v >= value * 0.999);
}

/** The points of a curve from `from` to `to`; its ends are interpolated. */
function within(points, from, to) {
  const inside = points.filter(([x]) => x >= from && x <= to);
  const ends = [from, to].map((x) => [x, valueAt(points, x)]);
  if (ends[0][1] !== null && inside[0]?.[0] !== from) inside.unshift(ends[0]);
  if (ends[1][1] !== null && inside.at(-1)?.[0] !== to) inside.push(ends[1]);
  return inside;
}

/** The value of a curve at `x`; null outside. */
function valueAt(points, x) {
  const next = points.findIndex(([at]) => at >= x);
  if (next < 0 || (next === 0 && points[0][0] > x)) return null;
  if (points[next][0] === x) return points[next][1];
  const [[x0, y0], [x1, y1]] = [points[next - 1], points[next]];
  return y0 + ((x - x0) / (x1 - x0)) * (y1 - y0);
}

/** The stretches of a curve whose intervals `ends` ([low, high] or null for each point) are known: the lower and the
 * upper side of each. */
function bandsOf({ points, ends = [] }) {
  const runs = [];
  points.forEach(([x], i) => {
    if (!ends[i]) return;
    if (!ends[i - 1]) runs.push([[], []]);
    runs.at(-1).forEach((side, bound) => side.push([x, ends[i][bound]]));
  });
  return runs;
}

/** Curves with the values under the pointer, or at a cursor that the arrow keys move. A drag zooms in, a double click
 * or Escape out. `element` can be filled repeatedly, and keeps the zoom. */
export class Chart {
  constructor() {
    this.svg = s("svg.plot", { viewBox: `0 0 ${W} ${H}`, role: "img", tabindex: "0" });
    this.values = h("span.chart-values");
    const csv = () => download(new Blob([this.csv()], { type: "text/csv" }), "chart.csv");
    const svg = () =>
      download(new Blob([pictureOf(this.svg)], { type: "image/svg+xml" }), "chart.svg");
    const button = (text, title, onclick) => h("button.small", { text, title, onclick });
    this.element = h(
      "div.chart",
      this.svg,
      h(
        "div.chart-tools",
        this.values,
        button("CSV", "Values as a table", csv),
        button("SVG", "Picture", svg),
      ),
    );
    this.view = null; // [from, to] that is zoomed into
    this.cursor = null;
    this.svg.onpointerdown = (event) => {
      this.from = this.xOf(event);
      this.svg.setPointerCapture(event.pointerId);
    };
    this.svg.onpointermove = (event) => this.point(this.xOf(event));
    this.svg.onpointerup = (event) => this.zoomTo(this.from, this.xOf(event));
    this.svg.onpointerleave = () => this.point(null);
    this.svg.ondblclick = () => this.zoomOut();
    this.svg.onkeydown = (event) => this.key(event);
  }

  /** `curves`: [{name, points: [[x, y], ...], ends}, ...]; `ends`, if there are any: the interval of each point as
   * [low, high], null where it is not known. `shape(svg)` is called after each drawing. */
  show(curves, xName, shape = () => {}) {
    Object.assign(this, { curves, xName, shape });
    this.draw();
    return this.element;
  }

  /** The range of x that is shown. */
  get range() {
    const ends = this.curves.flatMap(({ points }) => points.map(([x]) => x));
    const whole = [0, Math.max(...ends, 1e-9)];
    return this.view && this.view[0] < whole[1] ? this.view : whole;
  }

  xOf(event) {
    const box = this.svg.getBoundingClientRect();
    const [from, to] = this.range;
    const share = (((event.clientX - box.left) / box.width) * W - LEFT) / (W - LEFT - RIGHT);
    return from + Math.max(0, Math.min(1, share)) * (to - from);
  }

  zoomTo(a, b) {
    const [from, to] = this.range;
    if (Math.abs(b - a) < (to - from) / 50) return;
    this.view = [Math.min(a, b), Math.max(a, b)];
    this.draw();
  }

  zoomOut() {
    this.view = null;
    this.draw();
  }

  key(event) {
    const [from, to] = this.range;
    const at = this.cursor ?? from;
    const half = (to - from) / 4;
    const act = {
      ArrowLeft: () => this.point(Math.max(from, at - (to - from) / 50)),
      ArrowRight: () => this.point(Math.min(to, at + (to - from) / 50)),
      "+": () => this.zoomTo(Math.max(from, at - half), Math.min(to, at + half)),
      "-": () => this.zoomOut(),
      Escape: () => this.zoomOut(),
    }[event.key];
    if (!act) return;
    event.preventDefault();
    event.stopPropagation();
    act();
    if (this.values.textContent) announce(this.values.textContent);
  }

  /** Show the values at `x`; null: none. */
  point(x) {
    this.cursor = x;
    this.line?.remove();
    this.line = null;
    const said =
      x === null ? [] : this.curves.map((c) => [c.name, valueAt(c.points, x), boundsAt(c, x)]);
    const known = said.filter(([, value]) => value !== null);
    const texts = known.map(
      ([name, value, ends]) =>
        `${name}: ${rounded(value, 4)}${ends ? ` (${ends.map((y) => rounded(y, 4)).join(" to ")})` : ""}`,
    );
    this.values.textContent = x === null ? "" : [`${this.xName} ${short(x)}`, ...texts].join(" · ");
    if (x === null) return;
    const [from, to] = this.range;
    const at = LEFT + ((x - from) / (to - from)) * (W - LEFT - RIGHT);
    this.line = s("line.cursor", { x1: at, x2: at, y1: TOP, y2: H - BOTTOM });
    this.svg.append(this.line);
  }

  /** A row for each x of any curve. */
  csv() {
    const quoted = (text) => `"${String(text).replaceAll('"', '""')}"`;
    const xs = [...new Set(this.curves.flatMap(({ points }) => points.map(([x]) => x)))];
    const cells = (curve, x) => [
      valueAt(curve.points, x) ?? "",
      ...(curve.ends ? (boundsAt(curve, x) ?? ["", ""]) : []),
    ];
    const rows = xs
      .sort((a, b) => a - b)
      .map((x) => [x, ...this.curves.flatMap((curve) => cells(curve, x))]);
    const named = ({ name, ends }) => [name, ...(ends ? [`${name}, low`, `${name}, high`] : [])];
    const heads = [this.xName, ...this.curves.flatMap(named)].map(quoted);
    return `${[heads, ...rows].map((row) => row.join(",")).join("\n")}\n`;
  }

  draw() {
    const { curves, xName, svg: plot } = this;
    const [x0, x1] = this.range;
    const shown = curves.map(({ points }) => within(points, x0, x1));
    const bands = curves.map((curve) =>
      bandsOf(curve).map((sides) => sides.map((side) => within(side, x0, x1))),
    );
    const y1 = nice(Math.max(...[...shown.flat(), ...bands.flat(3)].map(([, y]) => y), 1e-9));
    const px = (x) => LEFT + ((x - x0) / (x1 - x0)) * (W - LEFT - RIGHT),
      py = (y) => H - BOTTOM - (y / y1) * (H - BOTTOM - TOP);
    plot.replaceChildren();
    const zoomed = this.view ? `, from ${short(x0)} to ${short(x1)}` : "";
    plot.setAttribute(
      "aria-label",
      `${curves.map((c) => c.name).join(", ")} over ${xName}${zoomed}`,
    );
    for (let i = 0; i <= 4; i++) {
      const y = (y1 * i) / 4,
        x = x0 + ((x1 - x0) * i) / 4;
      plot.append(s("line.axis", { x1: LEFT, x2: W - RIGHT, y1: py(y), y2: py(y) }));
      plot.append(s("text", { x: LEFT - 5, y: py(y) + 3, "text-anchor": "end", text: number(y) }));
      plot.append(
        s("text", {
          x: px(x),
          y: H - BOTTOM + 13,
          "text-anchor": i === 4 ? "end" : "middle",
          text: short(x),
        }),
      );
    }
    plot.append(
      s("text", { x: (LEFT + W - RIGHT) / 2, y: H - 2, "text-anchor": "middle", text: xName }),
    );
    const line = (points) =>
      points.map(([x, y], j) => `${j ? "L" : "M"}${px(x).toFixed(1)} ${py(y).toFixed(1)}`).join("");
    bands.forEach((runs, i) =>
      runs.forEach(([low, high]) => {
        const path = s("path.interval", { d: `${line([...low, ...high.reverse()])}Z` });
        path.style.fill = CURVES[i % CURVES.length];
        plot.append(path);
      }),
    );
    shown.forEach((points, i) => {
      const path = s("path", { d: line(points) });
      path.style.stroke = CURVES[i % CURVES.length];
      plot.append(path);
    });
    this.shape(plot);
    if (this.cursor !== null) this.point(this.cursor);
  }
}

/** The interval of a curve at `x`; null where it is not known. */
function boundsAt(curve, x) {
  const found = bandsOf(curve).map((sides) => sides.map((side) => valueAt(side, x)));
  return found.find(([low]) => low !== null) ?? null;
}

const short = (x) => rounded(x, 3);

/** A chart of curves that is drawn once; as in `Chart.show`. */
export const curvePlot = (curves, xName) => new Chart().show(curves, xName);

/** `bars`: [[name, value from 0 to 1, its interval as [low, high] if it has one], ...]. */
export function barPlot(bars) {
  const row = 18,
    height = bars.length * row + 4;
  const plot = s("svg.plot", {
    viewBox: `0 0 ${W} ${height}`,
    role: "img",
    "aria-label": bars
      .map(([name, value, ends]) => {
        const span = ends ? ` (${ends.map(number).join(" to ")})` : "";
        return `${name}: ${number(value)}${span}`;
      })
      .join(", "),
  });
  const at = (share) => 40 + share * (W - 100);
  bars.forEach(([name, value, ends], i) => {
    const y = i * row + 3;
    plot.append(s("text", { x: 34, y: y + 10, "text-anchor": "end", text: name }));
    const bar = s("rect", {
      x: 40,
      y,
      width: Math.max(0.5, value * (W - 100)),
      height: row - 6,
      rx: 2,
    });
    bar.style.fill = CURVES[0];
    const middle = y + row / 2 - 3;
    const [from, to] = (ends ?? [value, value]).map(at);
    plot.append(bar, s("text", { x: 6 + to, y: y + 10, text: number(value) }));
    if (ends) plot.append(s("line.interval", { x1: from, x2: to, y1: middle, y2: middle }));
  });
  return plot;
}

/** The 95 % band of a count at a time; `growth`: rate, variance per second (chance), variance per square second
 * (uncertain rate). */
export function band([rate, chance, doubt], time) {
  const half = 1.96 * Math.sqrt(chance * time + doubt * time * time);
  return [Math.max(rate * time - half, 0), rate * time + half];
}

/** Show prediction bands from time 0 to `end` in a chart, and above them an observed line if there is one. `bands`:
 * [{name, growth, kind}, ...], `kind` their class; `line`: {name, points}. */
export function showBands(chart, bands, line, end) {
  const times = Array.from({ length: 41 }, (_, i) => (end * i) / 40);
  const edges = bands.flatMap(({ name, growth }) =>
    ["lower", "upper"].map((bound, side) => ({
      name: `${name}, ${bound} bound`,
      points: times.map((time) => [time, band(growth, time)[side]]),
    })),
  );
  return chart.show([...(line ? [line] : []), ...edges], "time (s)", (plot) => {
    const paths = [...plot.querySelectorAll("path")];
    const observed = line && paths.shift();
    bands.forEach(({ kind = "" }, i) => {
      const [low, high] = paths.slice(2 * i, 2 * i + 2);
      const back = high.getAttribute("d").slice(1).split("L").reverse().join("L");
      low.setAttribute("d", `${low.getAttribute("d")}L${back}Z`);
      low.setAttribute("class", `band ${kind}`.trim());
      low.style.stroke = ""; // that of the class
      high.remove();
    });
    if (observed) plot.append(observed);
  });
}
