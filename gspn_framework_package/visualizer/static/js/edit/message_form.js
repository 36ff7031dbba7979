// The goal, request or message of an action as a form: the fields of its type with their defaults. Fields left empty
// are not written. If the type is not known, any fields can be given.

import { h } from "../dom.js";
import { get } from "../api.js";
import { YES_NO, dataField, fields, isReference, kindOf, valueField } from "./data_form.js";
import { numbersIn, typeOf } from "./schema.js";

const known = new Map(); // "kind type" -> {sent, received, why}; null: requested

const ASKED = { why: "asking the server for its fields …", waiting: true };

/** The fields of an action's messages, if known already; the form is redrawn when they arrive. */
export function messagesOf(form, kind, type) {
  if (!type) return { why: "" };
  const key = `${kind} ${type}`;
  if (!known.has(key)) {
    known.set(key, null);
    get("edit/fields", { kind, type })
      .then((answer) => known.set(key, answer))
      .catch((error) => known.set(key, { why: error.message, failed: true }))
      .then(() => form.refresh());
  }
  const found = known.get(key);
  if (found?.failed) known.delete(key); // requested again at the next drawing
  return found ?? ASKED;
}

/** The fields of a message by their paths: "pose.position.x". Fields inside arrays are left out. */
export function pathsOf(tree, before = "") {
  return (tree ?? []).flatMap(({ name, array, fields: inside }) => [
    before + name,
    ...(inside && !array ? pathsOf(inside, `${before}${name}.`) : []),
  ]);
}

/** A hint for the schema form: how to draw the goal, request or message of an action. */
export const messageHint = (messages, type) => ({
  draw: (form, lens, title) => [
    h(
      "fieldset.message",
      h("legend", title, type && h("code", type)),
      messages.why && !messages.waiting
        ? h("p.muted", `Any fields can be given here: ${messages.why}.`)
        : messages.waiting && h("p.muted", messages.why),
      messages.sent ? message(form, lens, title, messages.sent, true) : fields(form, lens, title),
    ),
  ],
});

/** A message: its fields, or data instead. `drop`: remove the message with its last field. */
function message(form, lens, label, tree, drop) {
  const value = lens.get();
  if (isReference(value)) return fromData(form, lens, label);
  if (value !== undefined && typeOf(value) !== "object") return misfit(form, lens, label, "fields");
  const foreign = Object.keys(value ?? {}).filter((name) => !tree.some((it) => it.name === name));
  return h(
    "div.nest",
    { role: "group", "aria-label": label },
    tree.length ? null : h("p.muted", "It has no fields."),
    tree.map((field) =>
      one(form, lens.at(field.name, { given: true, drop }), `${label} ${field.name}`, field),
    ),
    foreign.map((name) => {
      const at = lens.at(name, { given: true, drop });
      return h(
        "div.named",
        h("span.name", name),
        h("p.wrong", "The type has no field of this name."),
        valueField(form, at, `${label} ${name}`, {
          remove: form.removal(at, `${label} ${name}`, lens.key),
        }),
      );
    }),
  );
}

/** One field, with its name and type. */
function one(form, lens, label, field) {
  const { name, type, array, length, fields: inside } = field;
  const written = array ? `${type}[${length ?? ""}]` : type;
  const title = [h("span", name), " ", h("span.of-type", written)];
  if (isReference(lens.get()) || !(inside || array))
    return row(form, lens, label, title, () => leaf(form, lens, label, field));
  const body = array ? list(form, lens, label, field) : message(form, lens, label, inside, true);
  const details = form.section(lens.key, "", lens.get() !== undefined, body);
  details.querySelector("summary").replaceChildren(...title);
  return h("div.typed-part", details, toggle(form, lens, label));
}

/** A row of a form: the name, the value or the data that it comes from, and the button that switches between the two.
 */
function row(form, lens, label, title, draw, remove = null) {
  return h(
    "div.typed",
    h("span.typed-name", title),
    h("div.typed-value", isReference(lens.get()) ? fromData(form, lens, label) : draw()),
    h("div.entry", toggle(form, lens, label), remove),
  );
}

/** The button that switches between a value given here and one taken from data. */
function toggle(form, lens, label) {
  const on = isReference(lens.get());
  const key = `${lens.key} source`;
  return form.button(
    key,
    "data",
    () => {
      form.wanted = key;
      form.put(lens, on ? undefined : { from: "task.id" }, `Change the source of ${label}`);
    },
    {
      class: "source",
      "aria-label": `${label} from data`,
      "aria-pressed": String(on),
      title: on ? "Give the value here" : "Take the value from the data of the robot, team or task",
    },
  );
}

const fromData = (form, lens, label) =>
  dataField(form, lens, label, { "aria-label": `${label}: name of the data`, what: label });

/** A value that its field cannot hold, shown as written. */
function misfit(form, lens, label, wanted) {
  return [
    h("p.wrong", `The value is ${kindOf(lens.get())}; the type requires ${wanted}.`),
    valueField(form, lens, label, { remove: form.removal(lens, label, `${lens.key} source`) }),
  ];
}

const BITS = /^(u?)int(8|16|32|64)$/;

/** The range of an integer type; types with values that JavaScript cannot represent exactly are left out. */
function rangeOf(type) {
  const name = { char: "uint8", byte: "int8" }[type] ?? type;
  const found = name.match(BITS);
  if (!found) return null;
  const bits = Number(found[2]);
  const most = Math.min(2 ** (bits - (found[1] ? 0 : 1)) - 1, Number.MAX_SAFE_INTEGER);
  return [found[1] ? 0 : Math.max(-most - 1, Number.MIN_SAFE_INTEGER), most];
}

/** What is wrong with a number for a field; "" if nothing is. */
function problemOfNumber(type, value) {
  const range = rangeOf(type);
  if (!range) return "";
  if (!Number.isInteger(value)) return `${type} must be a whole number`;
  return value < range[0] || value > range[1]
    ? `${type} must be from ${range[0]} to ${range[1]}`
    : "";
}

/** The control of a field with a single value. */
function leaf(form, lens, label, { type, default: absent }) {
  const value = lens.get();
  const aria = { "aria-label": label, what: label };
  if (type === "bool") {
    if (value !== undefined && typeof value !== "boolean")
      return misfit(form, lens, label, "yes or no");
    return form.choice(
      lens,
      label,
      [[undefined, `${absent ? "yes" : "no"} (default)`], ...YES_NO],
      aria,
    );
  }
  if (type === "time" || type === "duration") return moment(form, lens, label, type);
  if (type === "string") {
    if (value !== undefined && typeof value !== "string")
      return misfit(form, lens, label, "a text");
    return form.text(lens, label, { ...aria, placeholder: "empty" });
  }
  if (value !== undefined && typeof value !== "number")
    return misfit(form, lens, label, "a number");
  return form.number(lens, label, {
    ...aria,
    blank: { value: undefined },
    placeholder: String(absent ?? 0),
    check: (it) => problemOfNumber(type, it),
  });
}

/** A time: the latest, now, or in seconds. */
function moment(form, lens, label, type) {
  const seconds = (it) => it.secs + it.nsecs / 1e9;
  return form.text(lens, label, {
    "aria-label": label,
    what: label,
    placeholder: type === "time" ? "0, or now" : "0",
    names: type === "time" ? ["now"] : null,
    show: (it) =>
      it && typeof it === "object" ? seconds({ secs: 0, nsecs: 0, ...it }) : (it ?? ""),
    parse: (text) => {
      const wanted = text.trim();
      if (!wanted) return [undefined];
      if (wanted === "now") return type === "time" ? ["now"] : "a duration is a number of seconds";
      const value = Number(wanted);
      if (!Number.isFinite(value) || (type === "time" && value < 0))
        return `'${wanted}' is not a number of seconds${type === "time" ? " or the word now" : ""}`;
      const secs = Math.floor(value);
      return [{ secs, nsecs: Math.round((value - secs) * 1e9) }];
    },
    late: true,
  });
}

/** An array: numbers in one field, other items one below the other. */
function list(form, lens, label, field) {
  const { type, length, fields: inside } = field;
  const value = lens.get();
  if (value !== undefined && !Array.isArray(value)) return misfit(form, lens, label, "a list");
  const item = { ...field, array: false };
  const simple = !inside && !["string", "bool", "time", "duration"].includes(type);
  if (simple && (value ?? []).every((it) => typeof it === "number"))
    return form.text(lens, label, {
      "aria-label": label,
      what: label,
      late: true,
      placeholder: length ? `${length} numbers with spaces between` : "numbers separated by spaces",
      show: (it) => (it ?? []).join(" "),
      parse: (text) => numbersOf(text, type, length),
    });
  const drop = (i) => {
    const left = lens.get().filter((_, at) => at !== i);
    form.put(lens, left.length ? left : undefined, `Remove ${label} ${i + 1}`);
  };
  return h(
    "div.nest",
    { role: "group", "aria-label": label },
    (value ?? []).map((_, i) => {
      const at = lens.at(i, { given: true, list: true });
      const named = `${label} ${i + 1}`;
      const remove = form.remove(at.key, named, () => drop(i), `${lens.key} add`);
      const safe = kept(at, field);
      const draw = () =>
        inside ? message(form, at, named, inside, false) : leaf(form, safe, named, item);
      return row(form, safe, named, String(i + 1), draw, remove);
    }),
    form.button(
      `${lens.key} add`,
      "Add an item",
      () => form.put(lens, [...(lens.get() ?? []), blankOf(field)], `Add to ${label}`),
      {
        "aria-label": `Add an item to ${label}`,
        disabled: Boolean(length) && (value ?? []).length >= length,
      },
    ),
    length && value && value.length !== length ? h("p.wrong", `${length} items are needed.`) : null,
  );
}

const blankOf = (field) => (field.fields ? {} : field.default);

/** An item of a list. If emptied, it takes its default and keeps its position. */
const kept = (lens, field) =>
  lens.as(
    (it) => it,
    (it) => (it === undefined ? blankOf(field) : it),
  );

function numbersOf(text, type, length) {
  const { values, problem } = numbersIn(text);
  if (!values.length) return [undefined];
  const wrong = problem || values.map((it) => problemOfNumber(type, it)).find(Boolean);
  if (wrong) return wrong;
  return length && values.length !== length ? `${length} numbers are needed` : [values];
}
