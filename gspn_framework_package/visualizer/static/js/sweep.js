// A sweep: its form, and its points as a table, and plots of each measure over the varied parameter.

import { h, number, table } from "./dom.js";
import { curvePlot, CURVES } from "./plot.js";

const PLOTS = 8;
const CURVES_SHOWN = 8;

/** "a, b" as ["a", "b"]. */
const listed = (text) =>
  text
    .split(",")
    .map((part) => part.trim())
    .filter(Boolean);

/** The fields of a sweep in addition to those of simulated runs: {key: {label, input}}. */
export function sweepFields(text) {
  return {
    vary: { label: "Vary", input: text("an-sweep-vary", "robots=1..5") },
    also: { label: "and", input: text("an-sweep-also", "rate:t1=0.5,1,2") },
    measure: { label: "Measure", input: text("an-sweep-measure", "t1, p1 (default: throughputs)") },
  };
}

/** The request for a sweep. `simulate`: the request for the runs at each point. */
export function sweepOf(fields, simulate) {
  const value = (key) => fields[key].input.value.trim();
  return {
    ...simulate,
    vary: [value("vary"), value("also")].filter(Boolean),
    measure: listed(value("measure")),
  };
}

const estimate = ({ mean, half_width: half }) => {
  const digits = (value, count) => number(Number(value.toPrecision(count)));
  return half ? `${digits(mean, 4)} ± ${digits(half, 2)}` : digits(mean, 4);
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
export function sweepCurves(names, points, { measure, name }) {
  const curves = new Map();
  for (const { values, measures } of points) {
    const found = measures[measure]?.[name];
    if (!found) continue;
    const title = names
      .slice(1)
      .map((other) => `${other}=${values[other]}`)
      .join(", ");
    if (!curves.has(title)) curves.set(title, []);
    curves.get(title).push([values[names[0]], found.mean]);
  }
  return [...curves].map(([title, line]) => ({ name: title || name, points: line }));
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
