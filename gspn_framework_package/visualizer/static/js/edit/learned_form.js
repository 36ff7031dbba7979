// Values that `gspn fit` learns from logs: durations, outcomes, failures, rates. Each may record its source; a change
// by hand removes the source.

import { h, number, plural } from "../dom.js";
import { changed } from "./net_edits.js";
import { problemOf, resolved } from "./schema.js";
import { numbersField, objectForm, schemaField, wordOf } from "./schema_form.js";

const without = (value) => changed(value, { of: undefined });
const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);

/** A lens at a value that may record what it was learned from: any other change to the value removes that record. */
function learned(lens) {
  return lens.as(
    (value) => value,
    (value, before) => {
      if (!value?.of || !before?.of || !same(value.of, before.of)) return value;
      return same(without(value), without(before)) ? value : without(value);
    },
  );
}

/** The source of a learned value, in words. */
function evidenceText(of) {
  if (!of) return "";
  const from = of.logs?.length ? ` in ${of.logs.join(", ")}` : "";
  const interval = of.interval
    ? `; 95 % interval ${number(of.interval[0])} to ${number(of.interval[1])}`
    : "";
  return `learned from ${plural(of.observations, "observation")}${from}${interval}`;
}

const START = { mean: 1, phases: 2, shape: 2, sigma: 0.5, low: 0, high: 2 };

const kindOf = (value) => value?.distribution ?? "exponential";

/** The mean of a duration, where the form needs it. */
function meanOf(value) {
  const kind = kindOf(value);
  if (kind === "uniform") return (value.low + value.high) / 2;
  if (kind === "hyper-erlang")
    return value.branches.reduce((sum, branch) => sum + branch.probability * branch.mean, 0);
  if (kind === "empirical") {
    const q = value.quantiles;
    return q.slice(1).reduce((sum, it, i) => sum + (it + q[i]) / 2, 0) / (q.length - 1);
  }
  return value.mean;
}

/** What is wrong with a duration beyond its schema. As in model/duration.py. */
function durationProblem(schema, value) {
  const kind = kindOf(value);
  const keys = schema.parameters[kind];
  const follows = !keys.includes("mean"); // the mean follows from the rest
  for (const key of keys) if (value[key] === undefined) return `${key} is missing`;
  const foreign = Object.keys(value).find(
    (key) => !["distribution", "of", "mean", ...keys].includes(key),
  );
  if (foreign) return `${foreign} does not belong to ${kind}`;
  if (!follows && kind !== "deterministic" && !(value.mean > 0)) return "mean must be above 0";
  if (kind === "lognormal" && value.sigma > 10) return "sigma must be at most 10";
  if (kind === "uniform" && !(value.low < value.high)) return "low must be below high";
  if (kind === "empirical") {
    const q = value.quantiles;
    if (q.some((it, i) => i && it < q[i - 1]) || q[0] === q.at(-1))
      return "list the times from the shortest to the longest";
  }
  if (kind === "hyper-erlang") {
    const sum = value.branches.reduce((total, branch) => total + branch.probability, 0);
    if (Math.abs(sum - 1) > 1e-6) return `the probabilities add up to ${number(sum)}, not 1`;
  }
  if (follows && value.mean !== undefined) {
    const mean = meanOf(value);
    if (Math.abs(value.mean - mean) > 0.01 * mean)
      return `the mean follows from the rest (${number(mean)} s): leave it out`;
  }
  return "";
}

/** The value with another distribution, with the same mean if that is known. */
function withKind(schema, value, kind) {
  const mean = meanOf(value) || 1;
  const result = { distribution: kind };
  for (const key of schema.parameters[kind])
    result[key] = value[key] ?? START[key] ?? schema.properties[key].default ?? 1;
  if ("mean" in result) result.mean = mean;
  if (kind === "uniform") Object.assign(result, { low: mean / 2, high: 1.5 * mean });
  if (kind === "empirical") result.quantiles = [mean / 2, mean, 1.5 * mean];
  if (kind === "hyper-erlang") result.branches = [{ probability: 1, phases: 1, mean }];
  return result;
}

export function durationForm(form, lens, title, schema) {
  const whole = form.whole(
    learned(lens),
    (value) => problemOf(schema, value, form.schema) || durationProblem(schema, value),
  );
  const value = whole.get() ?? {};
  const kind = kindOf(value);
  const distribution = whole.as(
    kindOf,
    (chosen, before) => withKind(schema, before ?? {}, chosen),
    "distribution",
  );
  const keys = schema.parameters[kind];
  const follows = !keys.includes("mean");
  const shown = [...keys, ...(value.mean !== undefined && follows ? ["mean"] : [])];
  return [
    form.labelled(
      "Distribution",
      form.choice(
        distribution,
        `${title}: distribution`,
        schema.properties.distribution.enum.map((it) => [it, it]),
      ),
    ),
    shown.map((key) => {
      const part = resolved(schema.properties[key], form.schema);
      const at = whole.at(key);
      const name = key === "mean" ? "Mean (s)" : wordOf(key);
      return key === "quantiles"
        ? form.labelled(name, numbersField(form, part, at, name), part.description)
        : schemaField(form, part, at, name, {}, !(key === "mean" && follows));
    }),
    form.verdict(whole),
    evidence(form, schema, whole, title),
  ];
}

/** The form of an object that may record what it was learned from. `check`: checks beyond its schema. */
export const learnedForm =
  (check = () => "") =>
  (form, lens, title, schema) => {
    const whole = form.whole(
      learned(lens),
      (value) => problemOf(schema, value, form.schema) || check(value),
    );
    return [
      objectForm(form, schema, whole, title, { without: ["of"] }),
      form.verdict(whole),
      evidence(form, schema, whole, title),
    ];
  };

/** The source of the value: in words, and as a form. */
function evidence(form, schema, lens, title) {
  const of = lens.at("of");
  const part = resolved(schema.properties.of, form.schema);
  return [
    of.get() && h("p.muted", evidenceText(of.get())),
    form.section(
      of.key,
      "Learned from",
      false,
      of.get()
        ? [
            objectForm(
              form,
              part,
              form.whole(of, (value) => problemOf(part, value, form.schema)),
              title,
            ),
            form.removal(of, "what it was learned from", null, `Remove the source of ${title}`),
          ]
        : form.button(`${of.key} add`, "Record what it was learned from", () =>
            form.put(of, { observations: 0 }, `Record what ${title} was learned from`),
          ),
    ),
  ];
}
