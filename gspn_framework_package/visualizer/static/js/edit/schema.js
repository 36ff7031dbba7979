// The JSON Schema of plan files, from the server. The forms are made from it, and input is checked against it before it
// enters the plan.

import { changed } from "./net_edits.js";

const TOLERANCE = 1e-6; // of a sum of probabilities; as in model/policy.py

let loaded = null;

/** The schema; it is fetched once. */
export function planSchema() {
  loaded ??= fetch("/plan.schema.json", { credentials: "same-origin" }).then((answer) => {
    if (!answer.ok) throw new Error(`the schema of plan files cannot be read (${answer.status})`);
    return answer.json();
  });
  loaded.catch(() => {
    loaded = null;
  });
  return loaded;
}

/** A part of the schema with its reference resolved; keys next to the reference are kept. */
export function resolved(schema, root) {
  if (!schema?.$ref) return schema;
  const found = schema.$ref
    .replace(/^#\//, "")
    .split("/")
    .reduce((at, key) => at[key], root);
  return resolved({ ...found, ...changed(schema, { $ref: undefined }) }, root);
}

/** The sum of probabilities: name -> probability. */
export const sumOf = (probabilities) =>
  Object.values(probabilities).reduce((total, it) => total + Number(it), 0);

/** Probabilities scaled so that they add up to `total`. */
export function scaled(probabilities, total = 1) {
  const names = Object.keys(probabilities);
  const sum = sumOf(probabilities);
  const share = (name) =>
    sum > 0 ? (Number(probabilities[name]) * total) / sum : total / names.length;
  return Object.fromEntries(names.map((name) => [name, Number(share(name).toPrecision(12))]));
}

/** What is wrong with the sum of probabilities. */
export function problemOfSum(probabilities = {}) {
  const sum = sumOf(probabilities);
  return Math.abs(sum - 1) <= TOLERANCE
    ? ""
    : `the probabilities add up to ${Number(sum.toPrecision(6))}, not 1`;
}

/** The numbers in a text, and what is wrong with one of them. */
export function numbersIn(text) {
  const words = text.split(/[\s,;]+/).filter(Boolean);
  const wrong = words.find((word) => !Number.isFinite(Number(word)));
  const problem = wrong === undefined ? "" : `'${wrong}' is not a number`;
  return { values: words.map(Number), problem };
}

export function typeOf(value) {
  if (value === null) return "null";
  if (Array.isArray(value)) return "array";
  return typeof value;
}

function isType(value, type) {
  const found = typeOf(value);
  return type === "integer" ? Number.isInteger(value) : found === type;
}

const WORDS = {
  string: "text",
  number: "a number",
  integer: "a whole number",
  boolean: "yes or no",
  array: "a list",
  object: "an object",
  null: "nothing",
};

/** What is wrong with a value of the plan, in words; "" if nothing. If the problem is inside the value, the text begins
 * with the key. */
export function problemOf(schema, value, root) {
  const s = resolved(schema, root);
  if (s === true || s === undefined) return "";
  if (s.type) {
    const types = [s.type].flat();
    if (!types.some((type) => isType(value, type)))
      return `${types.map((type) => WORDS[type]).join(" or ")} is needed`;
  }
  if (s.enum && !s.enum.includes(value)) return `one of ${s.enum.join(", ")} is needed`;
  if (typeof value === "number") {
    const bound = numberProblem(s, value);
    if (bound) return bound;
  }
  if (typeof value === "string") {
    if (s.minLength && value.length < s.minLength) return "it is empty";
    if (s.pattern && !new RegExp(s.pattern, "u").test(value))
      return s.description ? `expected form: ${s.description}` : "it does not have the right form";
  }
  if (Array.isArray(value)) {
    const found = listProblem(s, value, root);
    if (found) return found;
  } else if (typeOf(value) === "object") {
    const found = objectProblem(s, value, root);
    if (found) return found;
  }
  for (const part of s.allOf || []) {
    const found = problemOf(part, value, root);
    if (found) return found;
  }
  if (s.not && !problemOf(s.not, value, root))
    return s.not.required
      ? `${s.not.required.join(" and ")} exclude each other`
      : "it is not allowed";
  if (s.oneOf) {
    const found = s.oneOf.map((form) => problemOf(form, value, root));
    if (!found.includes("")) return nearest(s.oneOf, found, value, root);
  }
  return "";
}

/** What is wrong with a value, measured against the alternative it most likely stands for. */
function nearest(forms, problems, value, root) {
  const likely = forms.findIndex((form) => {
    const s = resolved(form, root);
    return typeOf(value) === "object"
      ? s.type === "object" && s.required?.length && s.required[0] in value
      : [s.type].flat().some((type) => type && isType(value, type));
  });
  return problems[likely] || problems.find((text) => !text.endsWith("is needed")) || problems[0];
}

function numberProblem(s, value) {
  if (!Number.isFinite(value)) return "a number is needed";
  if (s.minimum !== undefined && value < s.minimum) return `at least ${s.minimum}`;
  if (s.maximum !== undefined && value > s.maximum) return `at most ${s.maximum}`;
  if (s.exclusiveMinimum !== undefined && value <= s.exclusiveMinimum)
    return `more than ${s.exclusiveMinimum}`;
  if (s.exclusiveMaximum !== undefined && value >= s.exclusiveMaximum)
    return `less than ${s.exclusiveMaximum}`;
  return "";
}

function listProblem(s, value, root) {
  if (s.minItems && value.length < s.minItems)
    return s.minItems === 1 ? "an entry is needed" : `${s.minItems} entries are needed`;
  if (s.maxItems && value.length > s.maxItems) return `at most ${s.maxItems} entries`;
  if (s.uniqueItems) {
    const twice = value.find((item, i) => value.indexOf(item) < i);
    if (twice !== undefined) return `'${twice}' occurs twice`;
  }
  if (s.items)
    for (const [i, item] of value.entries()) {
      const found = problemOf(s.items, item, root);
      if (found) return `entry ${i + 1}: ${found}`;
    }
  return "";
}

function objectProblem(s, value, root) {
  const missing = (s.required || []).find((key) => !(key in value));
  if (missing) return `${missing} is missing`;
  for (const [key, needed] of Object.entries(s.dependencies || {}))
    if (key in value)
      for (const other of needed) if (!(other in value)) return `${key} needs ${other}`;
  for (const [key, item] of Object.entries(value)) {
    if (s.propertyNames) {
      const found = problemOf({ type: "string", ...s.propertyNames }, key, root);
      if (found) return `the name '${key}': ${found}`;
    }
    const known = s.properties?.[key] ?? s.additionalProperties;
    if (known === false) return `${key} does not belong here`;
    const found = problemOf(known, item, root);
    if (found) return `${key}: ${found}`;
  }
  return "";
}
