// Answers about time: the steady state, the way there, how long something takes, and simulated runs.

import { facts, h, number, plural, rounded } from "./dom.js";
import { curvePlot, CURVES } from "./plot.js";

export function steadyState(show, result) {
  const steady = result.steady_state;
  if (!steady)
    return show.section("Steady state", h("p", show.answer(result, "steady_state", null)));
  const tokens = Object.entries(steady.mean_tokens),
    flows = Object.entries(steady.throughput);
  const waits = new Map(Object.entries(steady.mean_waiting_time || {}));
  const states = result.likely_states || [];
  const stay = ({ mean_stay: value }) => (value === "infinite" ? "forever" : number(value));
  const titled = show.titled(result, "timing");
  const cell = (key, name, value) => show.cell(result, `steady_state.${key}`, name, value);
  if (steady.reward !== undefined) {
    const ends = show.within(result, "steady_state", "reward");
    titled.unshift(["Reward", `${number(steady.reward)} /s${ends}`]);
  }
  return show.section(
    "Steady state",
    titled.length > 0 && facts(titled),
    steady.component_count > 1 && [
      h(
        "p.muted",
        `The net ends up in one of ${steady.component_count} recurrent classes, ` +
          `${steady.deadlock_count} of them deadlocks.` +
          (steady.component_count > steady.components.length
            ? ` The ${steady.components.length} most probable:`
            : ""),
      ),
      show.table(
        ["Most of the time in", "probability", "states"],
        steady.components.map((part) => [
          Object.entries(part.marking)
            .map(([place, n]) => (n === 1 ? place : `${n} ${place}`))
            .join(", ") || "empty",
          number(part.probability),
          part.deadlock ? "deadlock" : number(part.states),
        ]),
        "table.states",
      ),
    ],
    h(
      "div.buttons",
      show.heat("Show mean tokens", "Mean number of tokens", steady.mean_tokens),
      show.heat("Show throughput", "Firings a second", steady.throughput),
    ),
    h("h3", "Tokens"),
    show.table(
      ["Place", "mean", "wait (s)"],
      tokens.map(([name, value]) => [
        show.node(name),
        cell("mean_tokens", name, value),
        cell("mean_waiting_time", name, waits.get(name) ?? null),
      ]),
    ),
    h("h3", "Throughput (1/s)"),
    show.table(
      ["Transition", "firings"],
      flows.map(([name, value]) => [show.node(name), cell("throughput", name, value)]),
    ),
    show.whyIntervals(result),
    show.distribution(steady.token_distribution, (place, count) =>
      show.ends(result, `steady_state.token_distribution.${place}`, count),
    ),
    states.length > 0 && [
      h("h3", "The most probable markings"),
      show.table(
        ["Marking", "probability", "mean stay (s)"],
        states.map((state) => [
          show.markingText(state.marking),
          rounded(state.probability, 4),
          stay(state),
        ]),
        "table.states",
      ),
    ],
    h("p.muted", `Residual ${number(steady.residual)}.`),
  );
}

export function simulated(show, found) {
  if (!found) return null;
  const estimate = (value) => {
    if (value === null) return "–";
    if (value.seen === false) {
      return `not seen${value.half_width === null ? "" : `, below ${rounded(value.half_width, 2)}`}`;
    }
    const mean = value.mean === null ? number(null) : rounded(value.mean, 4);
    if (value.half_width === 0) return `${mean} in every run`;
    return `${mean} ± ${value.half_width === null ? "?" : rounded(value.half_width, 2)}`;
  };
  const means = (values) =>
    Object.fromEntries(Object.entries(values).map(([name, value]) => [name, value.mean]));
  const estimates = (head, values) =>
    show.table(
      head,
      Object.entries(values).map(([name, value]) => [show.node(name), estimate(value)]),
    );
  return show.section(
    "Results of the runs",
    facts([
      [
        "Runs",
        `${found.replications.toLocaleString("en")}${found.time === null ? "" : ` of ${number(found.time)} s`}`,
      ],
      found.warmup > 0 && ["Left out", `the first ${number(found.warmup)} s`],
      ["Firings", found.events.toLocaleString("en")],
      ["Confidence", `${number(100 * found.confidence)} %`],
      ["Seed", String(found.seed)],
      found.reached && ["Reached the condition", estimate(found.reached)],
      found.time_to_condition && ["Time to reach it (s)", estimate(found.time_to_condition)],
      found.reached && ["Length of a run (s)", estimate(found.end_time)],
    ]),
    h(
      "div.buttons",
      show.heat("Show mean tokens", "Mean number of tokens (simulated)", means(found.mean_tokens)),
      show.heat("Show throughput", "Firings a second (simulated)", means(found.throughput)),
    ),
    h("h3", "Tokens"),
    estimates(["Place", "mean"], found.mean_tokens),
    h("h3", "Throughput (1/s)"),
    estimates(["Transition", "firings"], found.throughput),
    Object.entries(found.titles || {}).map(([key, title]) => [
      h("h3", title),
      estimates(["Subnet", "mean"], found[key]),
    ]),
    show.distribution(found.token_distribution),
  );
}

export function transient(show, result) {
  const found = result.transient;
  if (!found)
    return show.section("Tokens over time", h("p", show.answer(result, "transient", null)));
  const names = Object.keys(found[0].mean_tokens);
  const swing = (name) => {
    const values = found.map((entry) => entry.mean_tokens[name]);
    return Math.max(...values) - Math.min(...values);
  };
  const order = [...names].sort((a, b) => swing(b) - swing(a));
  const shown = new Set(order.slice(0, 4));
  const plot = h("div");
  const draw = () =>
    plot.replaceChildren(
      curvePlot(
        [...shown].map((name) => ({
          name,
          points: found.map((entry) => [entry.time, entry.mean_tokens[name]]),
          ends:
            result.intervals &&
            found.map((_, i) => show.ends(result, `transient.${i}.mean_tokens`, name)),
        })),
        "time (s)",
      ),
      show.key([...shown]),
    );
  const boxes = h(
    "div.choices",
    order.slice(0, 60).map((name) =>
      h(
        "label",
        h("input", {
          type: "checkbox",
          checked: shown.has(name),
          onchange: (event) => {
            if (event.target.checked) shown.add(name);
            else shown.delete(name);
            draw();
          },
        }),
        ` ${name} `,
      ),
    ),
  );
  draw();
  const why = () => show.whyIntervals(result, "Bands: the intervals of the answers");
  return [
    show.section("Mean tokens over time", plot, why(), boxes),
    show.section(
      "Distribution of tokens over time",
      distributionOverTime(show, result, order),
      why(),
    ),
  ];
}

/** The probability of each token count of a chosen place, over time. */
function distributionOverTime(show, result, order) {
  const found = result.transient;
  const endsAt = (i, name, count) =>
    count in found[i].token_distribution[name]
      ? show.ends(result, `transient.${i}.token_distribution.${name}`, count)
      : [0, 0];
  const draw = (name) => {
    const weight = new Map();
    for (const entry of found)
      for (const [count, p] of Object.entries(entry.token_distribution[name]))
        weight.set(count, Math.max(weight.get(count) || 0, p));
    const counts = [...weight]
      .filter(([, p]) => p > 0.005)
      .sort((a, b) => b[1] - a[1])
      .slice(0, CURVES.length)
      .map(([count]) => count)
      .sort((a, b) => a - b);
    const curves = counts.map((count) => ({
      name: plural(Number(count), "token"),
      points: found.map((entry) => [entry.time, entry.token_distribution[name][count] || 0]),
      ends: result.intervals && found.map((_, i) => endsAt(i, name, count)),
    }));
    return [curvePlot(curves, "time (s)"), show.key(curves.map((curve) => curve.name))];
  };
  return show.chosen("Place whose distribution is shown", order, draw);
}

export function settling(show, result) {
  const value = result.time_to_steady_state;
  return show.section(
    "Time to steady state",
    h(
      "p",
      value === null
        ? show.answer(result, "time_to_steady_state", null)
        : value === "infinite"
          ? "never"
          : `${number(value)} s`,
    ),
  );
}

export function passage(show, result) {
  return show.section(
    "How long until?",
    show.conditions(result, "mean_time_to", (found, i) => [
      facts([
        ["Condition", found.condition],
        [
          "Mean time",
          found.mean_time === "infinite"
            ? "infinite"
            : `${number(found.mean_time)} s${show.within(result, `mean_time_to.${i}`, "mean_time")}`,
        ],
        [
          "Probability",
          number(found.probability) + show.within(result, `mean_time_to.${i}`, "probability"),
        ],
      ]),
      show.whyIntervals(
        result,
        `In brackets${found.within.length > 1 ? ", and as a band" : ""}: the intervals of the answers`,
      ),
      found.within.length > 1 &&
        curvePlot(
          [
            {
              name: "probability",
              points: found.within.map((w) => [w.time, w.probability]),
              ends:
                result.intervals &&
                found.within.map((_, n) => show.ends(result, `mean_time_to.${i}`, `within.${n}`)),
            },
          ],
          "within (s)",
        ),
    ]),
  );
}
