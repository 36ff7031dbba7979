// What a robot does in a place: a choice among the kinds of action, and the fields of the chosen kind.

import { h, options } from "../dom.js";
import { problemOfData } from "./data_form.js";
import { functionWriter, parameterText } from "./function_form.js";
import { messageHint, messagesOf, pathsOf } from "./message_form.js";
import { nodeKey } from "./net_edits.js";
import { problemOf } from "./schema.js";
import { NAMES } from "./names.js";
import { objectForm } from "./schema_form.js";

const TITLES = {
  none: "nothing: done at once",
  function: "a function of the plan",
  server: "an action server",
  service: "a call of a service",
  publish: "publish a message",
  wait_for: "wait for a message",
  command: "a program",
  plan: "another plan (subnet)",
};
/** The initial value of an action, unless it is an object with empty texts. */
const START = { none: null, function: "", command: { command: [""] } };

/** The initial value of a setting whose parameter has this type in the source. */
const START_OF = { bool: false, int: 0, float: 0, list: [], tuple: [], dict: {} };

const SENT = { server: "goal", service: "request", publish: "message" };

/** The kinds of action in the schema: kind -> the schema of its object. */
function kindsOf(root) {
  const forms = root.definitions.action.oneOf.filter((form) => form.type === "object");
  return new Map([
    ...forms.map((form) => [form.required[0], form]),
    ["plan", root.definitions.subnet],
  ]);
}

function kindOfAction(value) {
  if (value === null) return "none";
  if (typeof value === "string") return "function";
  return ["function", "plan", "service", "publish", "wait_for", "command", "server"].find(
    (key) => key in value,
  );
}

/** The form of an action. A subnet is offered where the schema here allows one. */
export function actionField(form, lens, title, schema) {
  const root = form.schema;
  const allowed = JSON.stringify(schema).includes("definitions/subnet");
  const part = allowed
    ? root.properties.actions.additionalProperties
    : { $ref: "#/definitions/action" };
  const whole = form.whole(lens, (value) => problemOf(part, value, root));
  const value = whole.get();
  const kind = value === undefined ? undefined : kindOfAction(value);
  const kinds = kindsOf(root);
  const known = ["none", ...kinds.keys()].filter((it) => it !== "plan" || allowed);
  const choice = form.choice(
    whole.as(
      (it) => (it === undefined ? undefined : kindOfAction(it)),
      (chosen) =>
        chosen in START
          ? START[chosen]
          : Object.fromEntries(kinds.get(chosen).required.map((key) => [key, ""])),
      "kind",
    ),
    title,
    known.map((it) => [it, TITLES[it] ?? it]),
    { what: title },
  );
  // a function without settings is written as a text
  const object = whole.as(
    (it) => (typeof it === "string" ? { function: it } : it),
    (it, before) =>
      Object.keys(it).join() === "function" && (before === null || typeof before !== "object")
        ? it.function
        : it,
  );
  return h(
    "div.action-form",
    form.labelled("Action", choice),
    palette(form, whole, title, kind, allowed),
    kind === "function" && functionHelp(form, lens, value),
    kind !== undefined &&
      kind !== "none" &&
      objectForm(form, kinds.get(kind), object, title, {
        inside: hints(form, kind, object.get(), lens.name),
      }),
    kind === "plan" && opener(form, lens, value),
    form.verdict(whole),
  );
}

/** Where the palette lists what exists on ROS for a kind of action. */
const LIVE = { server: "actions", service: "services", publish: "topics", wait_for: "topics" };
const liveOf = (ros, kind) => ros?.[LIVE[kind]] ?? [];

/** The choices for a kind of action: [text, value, help]. */
function offered({ functions, plans, ros }, kind, allowed) {
  const live = (each, actionOf) =>
    liveOf(ros, each).map(({ name, type }) => [name, actionOf(name, type), type]);
  const list = {
    function: (functions ?? []).map(({ name, doc }) => [name, name, doc]),
    server: live("server", (name, type) => ({ type, server: name })),
    service: live("service", (name, type) => ({ service: name, type })),
    publish: live("publish", (name, type) => ({ publish: name, type })),
    wait_for: live("wait_for", (name, type) => ({ wait_for: name, type })),
    plan: allowed
      ? (plans ?? []).map(({ file, places }) => [
          file,
          { plan: file, entry: places?.[0] ?? "", exit: places?.at(-1) ?? "" },
          "",
        ])
      : [],
  };
  return kind === undefined || kind === "none" ? list : { [kind]: list[kind] ?? [] };
}

const GROUPS = {
  function: "Functions",
  server: "Running action servers",
  service: "Running services",
  publish: "Publish on",
  wait_for: "Wait for",
  plan: "Plans",
};

/** A menu of what exists: choosing an entry fills in the whole action. */
function palette(form, lens, title, kind, allowed) {
  if (!form.palette) return null;
  const entries = Object.entries(offered(form.palette, kind, allowed)).filter(
    ([, list]) => list.length,
  );
  if (!entries.length) return null;
  const all = entries.flatMap(([, list]) => list);
  const select = h(
    "select",
    { "data-key": `${lens.key} palette` },
    options([["", "existing ones …"]]),
    entries.map(([name, list]) =>
      h(
        "optgroup",
        { label: GROUPS[name] },
        list.map((entry) =>
          h("option", { value: all.indexOf(entry), text: entry[0], title: entry[2] || null }),
        ),
      ),
    ),
  );
  select.addEventListener("change", () => {
    if (select.value === "") return;
    const chosen = all[Number(select.value)][1];
    const before = lens.get();
    const same = kindOfAction(chosen) === (before === undefined ? undefined : kindOfAction(before));
    // an action of the same kind keeps its other settings
    const value =
      same && before && typeof before === "object"
        ? { ...before, ...(typeof chosen === "string" ? { function: chosen } : chosen) }
        : chosen;
    form.put(lens, value, `Change ${title}`);
  });
  return form.labelled("Palette", select);
}

const parameterName = (parameter) => (typeof parameter === "string" ? parameter : parameter.name);

function hints(form, kind, value, place) {
  const { functions = [], plans = [], ros, types = {} } = form.palette ?? {};
  const of = (list) => () => list.map(({ name }) => name);
  const { outcomes, keep } = actionHints(place);
  if (kind === "function") {
    const known = functions.find(({ name }) => name === value.function);
    return {
      function: { names: of(functions), placeholder: "module.function" },
      settings: {
        names: () => (known?.parameters ?? []).map(parameterName),
        // of the type that the function expects
        start: (_, name) => {
          const { default: usual, type } = known?.parameters.find((it) => it.name === name) ?? {};
          return usual ?? START_OF[type] ?? "";
        },
      },
      server: { placeholder: "the name of the place" },
    };
  }
  if (kind === "plan") {
    const known = plans.find(({ file }) => file === value.plan);
    const inside = known?.places ?? [];
    return {
      plan: { names: () => plans.map(({ file }) => file), title: "File of the plan" },
      entry: { names: () => inside },
      exit: { names: () => inside },
      with: { data: true, names: () => known?.parameters ?? [] },
      share: {
        each: { items: NAMES.resources },
        names: () => known?.resources ?? [],
        start: (state) => NAMES.resources(state)[0] ?? "",
      },
    };
  }
  if (kind === "command") return { outcomes, keep, command: { data: true } };
  const messages = messagesOf(form, kind, value.type);
  const live = liveOf(ros, kind);
  const known = live.map(({ type }) => type).filter(Boolean);
  return {
    [kind]: { names: of(live) },
    type: { names: () => [...known, ...(types[kind] ?? [])] },
    [SENT[kind]]: messageHint(messages, value.type),
    outcomes,
    keep: { ...keep, each: { names: () => pathsOf(messages.received) } },
  };
}

/** The button that opens the file of a subnet, once the plan refers to it. */
function opener(form, lens, value) {
  const key = nodeKey("place", lens.name);
  if (!value.plan || lens.get()?.plan !== value.plan) return null;
  return h(
    "div.buttons",
    form.button(`${lens.key} open`, `Open ${value.plan}`, () => form.mode.actions.openSubnet(key)),
  );
}

/** The docstring and the parameters of the function that an action names, and its source. */
function functionHelp(form, lens, value) {
  const name = typeof value === "string" ? value : value?.function;
  const known = form.palette?.functions?.find((it) => it.name === name);
  return [
    known &&
      h(
        "p.muted",
        known.doc || "The function has no docstring.",
        known.parameters?.length > 0 &&
          ` Parameters: ${known.parameters.map(parameterText).join(", ")}.`,
      ),
    functionWriter(form, lens, value),
  ];
}

/** The hints of `keep` and `outcomes` of an action in a place. */
const actionHints = (place) => ({
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
