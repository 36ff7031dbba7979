// Forms made from the schema of plan files, so that every key of a plan has one. The hints of a form (`form.hints`) add
// what the schema cannot express: pattern of a lens -> hint, see plan_hints.js.

import { h } from "../dom.js";
import { numbersIn, problemOf, resolved } from "./schema.js";
import { fields, problemOfKey, valueField } from "./data_form.js";

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
  keep: "Kept from the result",
  with: "Parameters of it",
  share: "Shared resources",
  command: "Program and arguments",
  evict_after: "Lost after (s)",
  fence_after: "Stops itself after (s)",
  fsync: "Write before sending",
  after: "After (s)",
  every: "Polled every (s)",
  id: "Field that identifies the task",
  json: "Field with the data as JSON",
  edge: "Only on a change",
  hold: "Held until it can fire",
  resume: "The next visit continues it",
  when: "When",
  $schema: "Schema for other editors",
};

/** A key in words. */
export const wordOf = (key) =>
  WORDS[key] ?? (key[0].toUpperCase() + key.slice(1)).replaceAll("_", " ");

const hintOf = (form, lens, given) => ({ ...form.hints[lens.pattern], ...given });

/** The controls of a value that a schema describes. `given`: hints for this place; `required`: it cannot be left out;
 * `title`: its name. */
export function schemaField(form, part, lens, title, given = {}, required = false) {
  const root = form.schema;
  const schema = resolved(part, root);
  const hint = hintOf(form, lens, given);
  if (hint.draw) return hint.draw(form, lens, title, schema, required);
  if (hint.whole) {
    const whole = form.whole(lens, (value) => problemOf(schema, value, root));
    return [objectForm(form, schema, whole, title, hint), form.verdict(whole)];
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
    if (hint.data) return group(title, valueField(form, lens, title, { kinds: ["array"] }));
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
          check: (name) => nameProblem(form, schema, name),
        }),
      );
    return mapForm(form, schema, lens, title, hint);
  }
  return group(title, valueField(form, lens, title)); // of any kind
}

/** Elements with a heading. */
export function group(title, ...body) {
  return h("fieldset", h("legend", title), body);
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
          ? `'${text}' is not valid here`
          : "") || [text]
      );
    },
  });
}

/** A list of numbers in one field. */
export function numbersField(form, schema, lens, title) {
  return form.text(lens, title, {
    placeholder: "numbers separated by spaces",
    show: (value) => (value ?? []).join(" "),
    parse: (text) => {
      const { values, problem } = numbersIn(text);
      if (!values.length) return [undefined];
      return problem || problemOf(schema, values, form.schema) || [values];
    },
    late: true,
  });
}

/** A list of texts, or of names of nodes if the hint lists them. */
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
    schema.description && h("p.muted", schema.description),
    h(
      "ul.chips",
      value.map((name, i) =>
        h(
          "li",
          h("span", name),
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
        form.removal(at, `${title} ${i + 1}`, `${lens.key} add`, `Remove from ${title}`),
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

/** The smallest value that a schema allows, as far as that can be derived. */
export function blankOf(part, root) {
  const schema = resolved(part, root);
  if (schema.default !== undefined) return schema.default;
  switch ([schema.type].flat()[0]) {
    case "object":
      return Object.fromEntries(
        (schema.required ?? []).map((key) => [key, blankOf(schema.properties[key], root)]),
      );
    case "array":
      return [];
    case "integer":
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
    "div.nest",
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

/** What is wrong with a name for a value in a map; "" if nothing is. */
const nameProblem = (form, { propertyNames: names }, name) =>
  names ? problemOf({ type: "string", ...names }, name, form.schema) : "";

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
    form.removal(inside(name), `${title} of ${called(name)}`, `${lens.key} add`);
  const offered = hint.keys?.(form.state).filter((name) => !(name in value));
  return group(
    title,
    schema.description && h("p.muted", schema.description),
    Object.keys(value).map((name) =>
      simple
        ? h(
            "div.with-remove",
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
            h("div.buttons", remove(name)),
          ]),
    ),
    offered
      ? addChoice(form, lens, title, offered, called, add)
      : form.namer(
          lens.key,
          `Add to ${title}`,
          (name) =>
            problemOfKey(lens, name) || hint.nameCheck?.(name) || nameProblem(form, schema, name),
          add,
          hint.names?.(form.state),
        ),
  );
}

function addChoice(form, lens, title, offered, called, add) {
  const texts = new Map(offered.map((name) => [called(name), name]));
  return form.adder(lens.key, `Add to ${title}`, [...texts.keys()], (text) => add(texts.get(text)));
}
