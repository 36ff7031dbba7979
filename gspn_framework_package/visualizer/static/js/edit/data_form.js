// Values of any kind, such as the fields of a goal or the settings of a function, as a form: texts, numbers, lists,
// objects, and references to data.

import { h } from "../dom.js";
import { typeOf } from "./schema.js";

const KINDS = [
  ["string", "text"],
  ["number", "number"],
  ["boolean", "yes or no"],
  ["data", "from data"],
  ["object", "fields"],
  ["array", "list"],
  ["null", "nothing"],
];
const EMPTY = {
  string: "",
  number: 0,
  boolean: false,
  data: { from: "task.id" },
  object: {},
  array: [],
  null: null,
};

export const YES_NO = [
  [true, "yes"],
  [false, "no"],
];

/** Whether a value refers to data: {from: NAME}. */
export const isReference = (value) =>
  typeOf(value) === "object" &&
  Object.keys(value).join() === "from" &&
  typeof value.from === "string";

export const kindOf = (value) => (isReference(value) ? "data" : typeOf(value));

/** Why this is not a name of data; "" if it is. */
export function problemOfData(name) {
  return /^((robot|team|task)\.)?[A-Za-z_][A-Za-z0-9_]{0,99}$/.test(name)
    ? ""
    : "a name of data consists of letters, digits and _, after an optional robot., team. or task.";
}

/** The control of a value that comes from data: its name. */
export const dataField = (form, lens, label, attributes) =>
  form.text(
    lens.as(
      (it) => it?.from,
      (from) => ({ from }),
    ),
    label,
    {
      ...attributes,
      names: dataNames(form.document.plan),
      parse: (text) => problemOfData(text) || [text],
    },
  );

/** The controls of one value: its kind and its content. `label` names it for screen readers. */
export function valueField(form, lens, label, { kinds = null, remove = null } = {}) {
  const value = lens.get();
  const kind = kindOf(value);
  const offered = KINDS.filter(([name]) => !kinds || kinds.includes(name) || name === kind);
  const chooser = form.choice(
    lens.as(kindOf, (it) => EMPTY[it]),
    label,
    offered,
    { what: `kind of ${label}`, "aria-label": `Kind of ${label}`, "data-key": `${lens.key} kind` },
  );
  const aria = { "aria-label": label, what: label };
  let control = null;
  let below = null;
  if (kind === "string") control = form.text(lens, label, { ...aria, parse: (text) => [text] });
  else if (kind === "number") control = form.number(lens, label, aria);
  else if (kind === "boolean") control = form.choice(lens, label, YES_NO, aria);
  else if (kind === "data") control = dataField(form, lens, label, aria);
  else if (kind === "object") below = fields(form, lens, label);
  else if (kind === "array") below = items(form, lens, label);
  return h("div.value", h("div.entry", chooser, control, remove), below);
}

/** Why an object cannot get an entry of this name; "" if it can. */
export function problemOfKey(lens, name) {
  if (!name) return "a name is needed";
  return name in (lens.get() ?? {}) ? "this name exists already" : "";
}

/** The fields of an object whose keys are free. `start`: name -> the value of a new one. */
export function fields(
  form,
  lens,
  label,
  { names = null, check = () => "", start = () => "" } = {},
) {
  const value = lens.get() ?? {};
  const inside = (name) => lens.at(name, { given: true });
  return h(
    "div.nest",
    { role: "group", "aria-label": label },
    Object.keys(value).map((name) =>
      h(
        "div.named",
        h("span.name", name),
        valueField(form, inside(name), `${label} ${name}`, {
          remove: form.removal(inside(name), `${label} ${name}`, `${lens.key} add`),
        }),
      ),
    ),
    form.namer(
      lens.key,
      `Another field of ${label}`,
      (name) => problemOfKey(lens, name) || check(name),
      (name) => {
        form.wanted = inside(name).key;
        form.put(inside(name), start(name), `Add ${label} ${name}`);
      },
      names,
    ),
  );
}

function items(form, lens, label) {
  const value = lens.get();
  const inside = (i) => lens.at(i, { given: true });
  return h(
    "div.nest",
    { role: "group", "aria-label": label },
    value.map((_, i) =>
      valueField(form, inside(i), `${label} ${i + 1}`, {
        remove: form.removal(inside(i), `${label} ${i + 1}`, `${lens.key} add`),
      }),
    ),
    form.button(
      `${lens.key} add`,
      "Add an item",
      () => {
        form.wanted = inside(value.length).key;
        form.put(
          lens,
          [...lens.get(), value.length ? EMPTY[kindOf(value.at(-1))] : ""],
          `Add to ${label}`,
        );
      },
      { "aria-label": `Add an item to ${label}` },
    ),
  );
}

/** The names of data that the plan's actions are known to write or read. */
function dataNames(plan) {
  const names = new Set(["task.id"]);
  const walk = (value) => {
    if (isReference(value)) names.add(value.from);
    else if (value && typeof value === "object") Object.values(value).forEach(walk);
  };
  for (const action of Object.values(plan.actions ?? {})) {
    walk(action);
    if (typeof action?.keep === "string") names.add(action.keep);
    else for (const name of Object.keys(action?.keep ?? {})) names.add(name);
  }
  return [...names].sort();
}
