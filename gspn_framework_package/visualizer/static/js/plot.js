// Small plots: curves over time, bars.

import { s, number } from "./dom.js";

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

/** `curves`: [{name, points: [[x, y], ...]}, ...]. */
export function curvePlot(curves, xName) {
  const all = curves.flatMap((curve) => curve.points);
  const x1 = Math.max(...all.map(([x]) => x), 1e-9),
    y1 = nice(Math.max(...all.map(([, y]) => y), 1e-9));
  const px = (x) => LEFT + (x / x1) * (W - LEFT - RIGHT),
    py = (y) => H - BOTTOM - (y / y1) * (H - BOTTOM - TOP);
  const plot = s("svg.plot", {
    viewBox: `0 0 ${W} ${H}`,
    role: "img",
    "aria-label": `${curves.map((c) => c.name).join(", ")} over ${xName}`,
  });
  for (let i = 0; i <= 4; i++) {
    const y = (y1 * i) / 4,
      x = (x1 * i) / 4;
    plot.append(s("line.axis", { x1: LEFT, x2: W - RIGHT, y1: py(y), y2: py(y) }));
    plot.append(s("text", { x: LEFT - 5, y: py(y) + 3, "text-anchor": "end", text: number(y) }));
    plot.append(
      s("text", {
        x: px(x),
        y: H - BOTTOM + 13,
        "text-anchor": i === 4 ? "end" : "middle",
        text: number(Number(x.toPrecision(3))),
      }),
    );
  }
  plot.append(
    s("text", { x: (LEFT + W - RIGHT) / 2, y: H - 2, "text-anchor": "middle", text: xName }),
  );
  curves.forEach((curve, i) => {
    const path = s("path", {
      d: curve.points
        .map(([x, y], j) => `${j ? "L" : "M"}${px(x).toFixed(1)} ${py(y).toFixed(1)}`)
        .join(""),
    });
    path.style.stroke = CURVES[i % CURVES.length];
    plot.append(path);
  });
  return plot;
}

/** `bars`: [[name, value from 0 to 1], ...]. */
export function barPlot(bars) {
  const row = 18,
    height = bars.length * row + 4;
  const plot = s("svg.plot", {
    viewBox: `0 0 ${W} ${height}`,
    role: "img",
    "aria-label": bars.map(([name, value]) => `${name}: ${number(value)}`).join(", "),
  });
  bars.forEach(([name, value], i) => {
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
    plot.append(bar, s("text", { x: 46 + value * (W - 100), y: y + 10, text: number(value) }));
  });
  return plot;
}

/** The 95 % band of a count at a time; `growth`: rate, variance per second (chance), variance per square second
 * (uncertain rate). */
export function band([rate, chance, doubt], time) {
  const half = 1.96 * Math.sqrt(chance * time + doubt * time * time);
  return [Math.max(rate * time - half, 0), rate * time + half];
}

/** Prediction bands from time 0 to `end`, and above them an observed line if there is one. `bands`: [{name, growth,
 * kind}, ...], `kind` their class; `line`: {name, points}. */
export function bandsPlot(bands, line, end) {
  const times = Array.from({ length: 41 }, (_, i) => (end * i) / 40);
  const edges = bands.flatMap(({ name, growth }) =>
    ["lower", "upper"].map((bound, side) => ({
      name: `${name}, ${bound} bound`,
      points: times.map((time) => [time, band(growth, time)[side]]),
    })),
  );
  const plot = curvePlot([...(line ? [line] : []), ...edges], "time (s)");
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
  return plot;
}

/** A prediction band with the observed line. `curve`: {name, growth, points: [[time, count], ...]}. */
export function bandPlot({ name, growth, points }) {
  const line = { name: `${name}, observed`, points: [[0, 0], ...points] };
  return bandsPlot([{ name: "predicted", growth }], line, Math.max(points.at(-1)[0], 1e-9));
}
