// The answer to a sweep: its points as a table, and plots of each measure over the varied parameter.

import { h, table, rounded } from "./dom.js";
import { curvePlot, CURVES } from "./plot.js";

const PLOTS = 8;
const CURVES_SHOWN = 8;

const estimate = ({ mean, half_width: half }) => {
  if (half === null) return `${rounded(mean, 4)} ± ?`;
  return half ? `${rounded(mean, 4)} ± ${rounded(half, 2)}` : rounded(mean, 4);
};

const titleOf = ({ measure, name }) => name || measure.replace(/_/g, " ");

function pointsOf(names, points, measures) {
  const cell = (text) => h("td.number", text);
  return h(
    "div.scroll",
    { id: "sweep-points" },
    table(
      "table",
      [...names, ...measures.map(titleOf)].map((text) => h("th.number", text)),
      points.map(({ values, measures: own }) => [
        ...names.map((name) => cell(String(values[name]))),
        ...measures.map(({ measure, name }) => {
          const found = own[measure]?.[name];
          return cell(found ? estimate(found) : "–");
        }),
      ]),
    ),
  );
}

/** The curves of a measure over the first of `names`, one for each combination of the others. */
function sweepCurves(names, points, { measure, name }) {
  const curves = new Map();
  for (const { values, measures } of points) {
    const found = measures[measure]?.[name];
    if (!found) continue;
    const title = names
      .slice(1)
      .map((other) => `${other}=${values[other]}`)
      .join(", ");
    if (!curves.has(title)) curves.set(title, { name: title || name, points: [], ends: [] });
    const { mean, half_width: half } = found;
    curves.get(title).points.push([values[names[0]], mean]);
    curves.get(title).ends.push(half === null ? null : [Math.max(mean - half, 0), mean + half]);
  }
  return [...curves.values()];
}

/** The answer so far. `show`: the pieces of the other answers. */
export function sweepAnswer(show, found) {
  if (!found) return null;
  const names = found.vary.map(({ name }) => name);
  const { measures } = found;
  const plots = measures.slice(0, PLOTS).map((measure) => {
    const curves = sweepCurves(names, found.points, measure).slice(0, CURVES_SHOWN);
    return [
      h("h3", titleOf(measure)),
      curves.length > 0 && curvePlot(curves, names[0]),
      names.length > 1 && show.key(curves.map(({ name }) => name).slice(0, CURVES.length)),
    ];
  });
  return show.section(
    "Points of the sweep",
    h("p.muted", `${found.points.length} of ${found.of} points`),
    plots,
    pointsOf(names, found.points, measures),
  );
}
