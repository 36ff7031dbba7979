// Forms made from the schema of plan files, so that no key of a plan is without one. HINTS say what the schema
// cannot: which names belong where, what a new entry begins with, and which form is drawn by hand.

import { h, natural } from "../dom.js";
import { changedCondition } from "./rename.js";
import { changed } from "./plan_document.js";
import { problemOf, resolved, typeOf } from "./schema.js";
import { fields, problemOfData, valueField } from "./data_form.js";
import { durationForm, evidence, learned } from "./learned_form.js";
import { robotsForm } from "./robots_form.js";
import { actionField } from "./action_form.js";

const sorted = new WeakMap(); // list of nodes -> its names: forms ask for them again and again

function names(nodes) {
  if (!sorted.has(nodes)) sorted.set(nodes, nodes.map(({ name }) => name).sort(natural));
  return [...sorted.get(nodes)];
}

/** The names that belong somewhere: (state, name of the entry) -> list. */
export const NAMES = {
  places: ({ net }) => names(net.places),
  placesAndAll: ({ net }) => ["*", ...names(net.places)],
  resources: ({ plan }) => [...(plan.resource_places ?? [])].sort(natural),
  actionPlaces({ net, plan }) {
    const resources = new Set(plan.resource_places);
    return names(net.places).filter((name) => !resources.has(name));
  },
  transitions: ({ net }) => names(net.transitions),
  timed: ({ net }) => names(net.transitions.filter(({ timed }) => timed)),
  immediate: ({ net }) => names(net.transitions.filter(({ timed }) => !timed)),
  leaving: ({ net }, place) =>
    [
      ...new Set(
        net.arcs.filter(({ from, inhibitor }) => from === place && !inhibitor).map(({ to }) => to),
      ),
    ].sort(natural),
};

const WORDS = {
  plan: "Name of the plan",
  resource_places: "Resource places",
  on_failure: "When an action fails",
  on_lost: "When a robot is lost",
  on_evict: "Given back on eviction",
  timeout: "Time-outs (s)",
  until: "Ends when",
  cancel_grace: "Grace to cancel (s)",
  done: "Tasks are done at",
  wait_for: "Topic",
  publish: "Topic",
  of: "Learned from",
  keep: "Keep of the result",
  with: "Parameters of it",
  share: "Shared resources",
  command: "Program and arguments",
  evict_after: "Lost after (s)",
  fence_after: "Stops itself after (s)",
  fsync: "Write before sending",
  after: "After (s)",
  every: "Asked every (s)",
  id: "Field that identifies the task",
  json: "Field with the data as JSON",
  edge: "Only a change counts",
  hold: "Held until it can fire",
  resume: "Continued by the next visit",
  when: "When",
  $schema: "Schema for other editors",
};

/** A key in words. */
export const wordOf = (key) =>
  WORDS[key] ?? (key[0].toUpperCase() + key.slice(1)).replaceAll("_", " ");

const placeCondition = (text, state) => {
  const known = new Set(state.net.places.map(({ name }) => name));
  let foreign = null;
  changedCondition(text, (name) => {
    if (
      !known.has(name) &&
      !/^(and|or|not|true|false|min|max|floor|ceil|round|abs|sqrt|exp|log|ln|pow|mod|e\d*)$/i.test(
        name,
      )
    )
      foreign ??= name;
    return name;
  });
  if (foreign) return `there is no place '${foreign}'`;
  if (!/[<>=!]|true|false/i.test(text)) return "a comparison is needed, such as p1 >= 1";
  const quotes = text.replace(/"[^"]*"|'[^']*'/g, "");
  if (/["']/.test(quotes)) return "a quote is opened and not closed";
  let depth = 0;
  for (const sign of quotes) {
    depth += sign === "(" ? 1 : sign === ")" ? -1 : 0;
    if (depth < 0) break;
  }
  return depth ? "the parentheses do not match" : "";
};

/** pattern of a lens -> {keys: names of the entries of a map, items: names of a list or a text, start: value of a new
 * entry, draw: a form of its own, check: what else may be wrong, open: names beside these are allowed, title: what the
 * key is called here}. */
export const HINTS = {
  "plan.resource_places": { items: NAMES.places },
  "plan.spawn": { items: NAMES.actionPlaces, twice: true },
  "plan.chance": { items: NAMES.actionPlaces },
  "plan.until": { check: placeCondition, placeholder: "Sorted >= 100" },
  "plan.actions": { keys: NAMES.actionPlaces, start: () => null, keepEmpty: true },
  "plan.actions.*": { draw: actionField },
  "plan.on_failure": { keys: NAMES.placesAndAll, start: () => "wait" },
  "plan.on_failure.*": { draw: failureRule },
  "plan.timeout": { keys: NAMES.placesAndAll, start: () => 60 },
  "plan.routing": { keys: NAMES.transitions, start: () => ({}), keepEmpty: true },
  "plan.routing.*": { keys: NAMES.actionPlaces, start: (_, name) => name },
  "plan.routing.*.*": { items: NAMES.actionPlaces },
  "plan.on_evict": { keys: NAMES.actionPlaces, start: () => ({}), keepEmpty: true },
  "plan.on_evict.*": { keys: NAMES.resources, start: () => 1 },
  "plan.durations": { keys: NAMES.actionPlaces, start: () => ({ mean: 1 }) },
  "plan.durations.*": { draw: durationForm },
  "plan.outcomes": {
    keys: NAMES.actionPlaces,
    start: (state, place) => {
      const leaving = NAMES.leaving(state, place);
      const share = 1 / (leaving.length || 1);
      return {
        probabilities: Object.fromEntries((leaving.length ? leaving : [""]).map((t) => [t, share])),
      };
    },
  },
  "plan.outcomes.*": { learned: true, check: sumsToOne },
  "plan.outcomes.*.probabilities": {
    keys: (state) => ["", ...NAMES.transitions(state)],
    start: () => 0,
  },
  "plan.failures": { keys: NAMES.actionPlaces, start: () => ({ probability: 0.1 }) },
  "plan.failures.*": { learned: true },
  "plan.rates": {
    keys: NAMES.timed,
    start: (state, name) => ({
      rate: state.net.transitions.find((it) => it.name === name)?.rate ?? 1,
    }),
  },
  "plan.rates.*": { learned: true },
  "plan.events": { keys: NAMES.timed, start: () => ({}), keepEmpty: true },
  "plan.events.*": { whole: true },
  "plan.events.*.settings": { data: true },
  "plan.tasks.queues": { items: NAMES.resources },
  "plan.tasks.done": { items: NAMES.transitions },
  "plan.parameters": { data: true },
  "plan.robots": { draw: robotsForm },
  "plan.on_lost": { draw: lostRule },
  "plan.subnets": {
    draw: () =>
      h("p", { class: "muted", text: "Written by the package; opening a subnet edits it." }),
  },
};

function sumsToOne(value) {
  const sum = Object.values(value?.probabilities ?? {}).reduce((total, it) => total + it, 0);
  return Math.abs(sum - 1) <= 1e-6
    ? ""
    : `the probabilities add up to ${Number(sum.toPrecision(6))}, not to 1`;
}

const hintOf = (lens, given) => ({ ...HINTS[lens.pattern], ...given });

/** The controls of a value that a schema describes. `given`: hints for this place; `required`: it cannot be left
 * out; `title`: what it is called. */
export function schemaField(form, part, lens, title, given = {}, required = false) {
  const root = form.schema;
  const schema = resolved(part, root);
  const hint = hintOf(lens, given);
  if (hint.draw) return hint.draw(form, lens, title, schema, required);
  if (hint.whole || (hint.check && schema.type === "object") || hint.learned) {
    const inner = hint.learned ? learned(lens) : lens;
    const whole = form.whole(
      inner,
      (value) => problemOf(schema, value, root) || hint.check?.(value, form.state) || "",
    );
    return [
      objectForm(form, schema, whole, title, hint.learned ? { ...hint, without: ["of"] } : hint),
      form.verdict(whole),
      hint.learned && evidence(form, schema, whole, title),
    ];
  }
  if (schema.enum) {
    const options = schema.enum.map((value) => [value, value]);
    if (!required) options.unshift([undefined, "as by default"]);
    return form.labelled(title, form.choice(lens, title, options), schema.description);
  }
  const type = [schema.type].flat();
  if (type.includes("boolean"))
    return form.labelled(title, form.check(lens, title, { absent: false }), schema.description);
  if (type.includes("number") || type.includes("integer"))
    return form.labelled(
      title,
      form.number(lens, title, {
        whole: !type.includes("number"),
        check: (value) => problemOf(schema, value, root),
        placeholder: hint.placeholder,
        ...(required ? {} : { blank: { value: type.includes("null") ? null : undefined } }),
        ...(type.includes("null") ? { blank: { value: null } } : {}),
      }),
      schema.description,
    );
  if (type.includes("string"))
    return form.labelled(
      title,
      textField(form, schema, lens, title, hint, required),
      schema.description,
    );
  if (type.includes("array")) {
    const item = resolved(schema.items ?? {}, root);
    if (hint.data) return group(title, valueList(form, lens, title));
    if (item.type === "number")
      return form.labelled(title, numbersField(form, schema, lens, title), schema.description);
    return item.type === "object"
      ? objectsForm(form, schema, lens, title)
      : listForm(form, schema, lens, title, hint);
  }
  if (type.includes("object") || schema.properties || schema.additionalProperties) {
    if (schema.properties) return group(title, objectForm(form, schema, lens, title, hint));
    if (hint.data || !schema.additionalProperties)
      return group(
        title,
        fields(form, lens, title, {
          names: hint.names?.(form.state),
          start: hint.start && ((name) => hint.start(form.state, name)),
          check: (name) =>
            schema.propertyNames
              ? problemOf({ type: "string", ...schema.propertyNames }, name, root)
              : "",
        }),
      );
    return mapForm(form, schema, lens, title, hint);
  }
  return group(title, valueField(form, lens, title)); // of any kind
}

/** Elements with a heading. */
export function group(title, ...body) {
  return h("fieldset", {}, h("legend", { text: title }), body);
}

function textField(form, schema, lens, title, hint, required) {
  const root = form.schema;
  return form.text(lens, title, {
    names: hint.items?.(form.state) ?? hint.names?.(form.state),
    placeholder: hint.placeholder,
    parse: (text) => {
      if (!text) return required ? "it is empty" : [undefined];
      return (
        problemOf(schema, text, root) ||
        hint.check?.(text, form.state) ||
        (hint.items && !hint.open && !hint.items(form.state).includes(text)
          ? `there is no '${text}' that fits here`
          : "") || [text]
      );
    },
  });
}

/** A list of numbers in one field. */
export function numbersField(form, schema, lens, title, check = () => "") {
  return form.text(lens, title, {
    placeholder: "numbers with spaces between",
    show: (value) => (value ?? []).join(" "),
    parse: (text) => {
      const words = text.split(/[\s,;]+/).filter(Boolean);
      if (!words.length) return [undefined];
      const value = words.map(Number);
      const wrong = words.find((_, i) => !Number.isFinite(value[i]));
      if (wrong !== undefined) return `'${wrong}' is not a number`;
      return problemOf(schema, value, form.schema) || check(value) || [value];
    },
    late: true,
  });
}

/** A list of texts: names of nodes, where the hint says which. */
function listForm(form, schema, lens, title, hint) {
  const value = lens.get() ?? [];
  const add = (name) => {
    form.wanted = `${lens.key} add`;
    form.put(lens, [...(lens.get() ?? []), name], `Add '${name}' to ${title}`);
  };
  const taken = new Set(hint.twice ? [] : value);
  const offered = hint.items?.(form.state).filter((name) => !taken.has(name));
  return group(
    title,
    schema.description && h("p", { class: "muted", text: schema.description }),
    h(
      "ul",
      { class: "chips" },
      value.map((name, i) =>
        h(
          "li",
          {},
          h("span", { text: name }),
          form.remove(
            `${lens.key}.${i}`,
            `${name} from ${title}`,
            () => {
              const left = (lens.get() ?? []).filter((_, at) => at !== i);
              form.put(lens, left.length ? left : undefined, `Remove '${name}' from ${title}`);
            },
            `${lens.key} add`,
          ),
        ),
      ),
    ),
    offered
      ? form.adder(lens.key, `Add to ${title}`, offered, add)
      : form.namer(
          lens.key,
          `Add to ${title}`,
          (name) =>
            problemOf(schema.items ?? {}, name, form.schema) ||
            (!name
              ? "it is empty"
              : value.includes(name) && schema.uniqueItems
                ? "it already exists"
                : ""),
          add,
        ),
  );
}

/** A list of objects. */
function objectsForm(form, schema, lens, title) {
  const value = lens.get() ?? [];
  return group(
    title,
    value.map((_, i) => {
      const at = lens.at(i, { given: true, list: true });
      return group(
        `${title} ${i + 1}`,
        schemaField(form, schema.items, at, `${title} ${i + 1}`),
        form.remove(
          at.key,
          `${title} ${i + 1}`,
          () => form.put(at, undefined, `Remove from ${title}`),
          `${lens.key} add`,
        ),
      );
    }),
    form.button(`${lens.key} add`, `Add to ${title}`, () =>
      form.put(
        lens,
        [...(lens.get() ?? []), blankOf(schema.items, form.schema)],
        `Add to ${title}`,
      ),
    ),
  );
}

function valueList(form, lens, title) {
  return valueField(form, lens, title, { kinds: ["array"] });
}

/** The smallest value that a schema allows, as far as it is known. */
function blankOf(part, root) {
  const schema = resolved(part, root);
  switch ([schema.type].flat()[0]) {
    case "object":
      return Object.fromEntries(
        (schema.required ?? []).map((key) => [key, blankOf(schema.properties[key], root)]),
      );
    case "array":
      return [];
    case "integer":
      return schema.minimum ?? 1;
    case "number":
      return schema.minimum ?? 1;
    case "boolean":
      return false;
    default:
      return "";
  }
}

/** The keys of an object that the schema knows by name. */
export function objectForm(form, schema, lens, title, hint = {}) {
  const left = hint.without ?? [];
  return h(
    "div",
    { class: "nest" },
    Object.entries(schema.properties)
      .filter(([key]) => !left.includes(key))
      .map(([key, part]) =>
        schemaField(
          form,
          part,
          lens.at(key, { drop: true }),
          hint.inside?.[key]?.title ?? wordOf(key),
          hint.inside?.[key] ?? {},
          (schema.required ?? []).includes(key),
        ),
      ),
  );
}

/** A map from names to values. */
function mapForm(form, schema, lens, title, hint) {
  const value = lens.get() ?? {};
  const part = schema.additionalProperties;
  const simple = ["number", "integer", "string"].includes(resolved(part, form.schema).type);
  const inside = (name) => lens.at(name, { given: true, drop: !hint.keepEmpty && !lens.required });
  const called = (name) => (name === "" ? "(none)" : name);
  const add = (name) => {
    form.wanted = simple ? inside(name).key : `fold ${inside(name).key}`;
    form.open.set(inside(name).key, true);
    const start =
      hint.start?.(form.state, name) ?? (hint.start ? null : blankOf(part, form.schema));
    form.put(inside(name), start, `Add ${title} of '${called(name)}'`);
  };
  const remove = (name) =>
    form.remove(
      inside(name).key,
      `${title} of ${called(name)}`,
      () => form.put(inside(name), undefined, `Remove ${title} of '${called(name)}'`),
      `${lens.key} add`,
    );
  const offered = hint.keys?.(form.state).filter((name) => !(name in value));
  return group(
    title,
    schema.description && h("p", { class: "muted", text: schema.description }),
    Object.keys(value).map((name) =>
      simple
        ? h(
            "div",
            { class: "with-remove" },
            schemaField(form, part, inside(name), called(name), hint.each ?? {}, true),
            remove(name),
          )
        : form.section(inside(name).key, called(name), Object.keys(value).length < 4, () => [
            schemaField(
              form,
              part,
              inside(name),
              `${title} of ${called(name)}`,
              hint.each ?? {},
              true,
            ),
            h("div", { class: "buttons" }, remove(name)),
          ]),
    ),
    offered
      ? addChoice(form, lens, title, offered, called, add)
      : form.namer(
          lens.key,
          `Add to ${title}`,
          (name) =>
            (!name
              ? "a name is needed"
              : name in (lens.get() ?? {})
                ? "there is one of this name"
                : "") ||
            (hint.nameCheck?.(name) ?? "") ||
            (schema.propertyNames
              ? problemOf({ type: "string", ...schema.propertyNames }, name, form.schema)
              : ""),
          add,
          hint.names?.(form.state),
        ),
  );
}

function addChoice(form, lens, title, offered, called, add) {
  const texts = new Map(offered.map((name) => [called(name), name]));
  return form.adder(lens.key, `Add to ${title}`, [...texts.keys()], (text) => add(texts.get(text)));
}

// -- forms of their own ------------------------------------------------------------------------------

/** wait, stop, retry N, fire T, {retry, delay}. */
function failureRule(form, lens, title) {
  const value = lens.get();
  const place = lens.name;
  const kind = typeOf(value) === "object" ? "retry" : String(value).split(" ")[0];
  const leaving = place === "*" ? NAMES.transitions(form.state) : NAMES.leaving(form.state, place);
  const START = { wait: "wait", stop: "stop", retry: "retry 3", fire: `fire ${leaving[0] ?? ""}` };
  const kinds = [
    ["wait", "wait for the operator"],
    ["stop", "stop the team"],
    ["retry", "try again"],
    ...(leaving.length || kind === "fire" ? [["fire", "fire a transition"]] : []),
  ];
  const times = lens.as(
    (it) => (typeOf(it) === "object" ? it.retry : Number(String(it).split(" ")[1])),
    (n, it) => (typeOf(it) === "object" ? { ...it, retry: n } : `retry ${n}`),
    "retry",
  );
  const delay = lens.as(
    (it) => (typeOf(it) === "object" ? it.delay : undefined),
    (seconds, it) => {
      const retry = typeOf(it) === "object" ? it.retry : Number(String(it).split(" ")[1]);
      return seconds === undefined ? `retry ${retry}` : { retry, delay: seconds };
    },
    "delay",
  );
  const rule = resolved(
    form.schema.properties.on_failure.additionalProperties.oneOf[1],
    form.schema,
  );
  return [
    form.labelled(
      "The robot",
      form.choice(
        lens.as(
          () => kind,
          (chosen) => START[chosen],
        ),
        title,
        kinds,
        { what: title },
      ),
    ),
    kind === "retry" && [
      form.labelled(
        "Times",
        form.number(times, `${title}: times`, {
          whole: true,
          check: (n) => problemOf(rule.properties.retry, n, form.schema),
        }),
      ),
      form.labelled(
        "Delay (s)",
        form.number(delay, `${title}: delay`, {
          blank: { value: undefined },
          check: (n) => problemOf(rule.properties.delay, n, form.schema),
        }),
      ),
    ],
    kind === "fire" && fired(form, lens, title, leaving),
  ];
}

function fired(form, lens, title, offered) {
  const which = lens.as(
    (it) => String(it).slice(5),
    (name) => `fire ${name}`,
    "fire",
  );
  return form.labelled(
    "Transition",
    form.choice(
      which,
      title,
      offered.map((name) => [name, name]),
      { what: title },
    ),
  );
}

/** hold, stop, fire T. */
function lostRule(form, lens, title, schema) {
  const value = lens.get();
  const kind = value?.split(" ")[0];
  const offered = NAMES.transitions(form.state);
  return [
    form.labelled(
      title,
      form.choice(
        lens.as(
          () => kind,
          (chosen) => (chosen === "fire" ? `fire ${offered[0]}` : chosen),
        ),
        title,
        [
          [undefined, "as by default (hold)"],
          ["hold", "hold: the others wait"],
          ["stop", "stop the team"],
          ...(offered.length ? [["fire", "fire a transition"]] : []),
        ],
      ),
      schema.description,
    ),
    kind === "fire" && fired(form, lens, title, offered),
  ];
}

/** The hints of `keep` and `outcomes` of an action in a place. */
export const actionHints = (place) => ({
  outcomes: {
    keys: () => ["succeeded", "aborted", "rejected", "preempted"],
    start: () => "",
    each: { draw: (form, lens, title) => outcome(form, lens, title, place) },
  },
  keep: {
    nameCheck: problemOfData,
    each: {},
  },
});

function outcome(form, lens, title, place) {
  return form.labelled(
    title,
    form.choice(lens, title, [
      ["", "the policy decides"],
      ...NAMES.leaving(form.state, place).map((name) => [name, name]),
    ]),
  );
}

/** An object without some keys. */
export const less = (object, ...keys) =>
  changed(object, Object.fromEntries(keys.map((key) => [key, undefined])));
