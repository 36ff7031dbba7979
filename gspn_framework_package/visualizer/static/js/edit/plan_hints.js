// Hints that the schema of plan files cannot express: which names are valid for a key, the initial value of a new
// entry, and custom forms.

import { h } from "../dom.js";
import { actionField } from "./action_form.js";
import { durationForm, learnedForm } from "./learned_form.js";
import { NAMES } from "./names.js";
import { changedCondition, isWord } from "./rename.js";
import { robotsForm } from "./robots_form.js";
import { failureRule, lostRule } from "./rule_form.js";
import { problemOfSum } from "./schema.js";

const placeCondition = (text, state) => {
  const known = new Set(state.net.places.map(({ name }) => name));
  let foreign = null;
  changedCondition(text, (name) => {
    // the exponent of a number looks like a name
    if (!known.has(name) && !isWord(name) && !/^e\d*$/i.test(name)) foreign ??= name;
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
 * entry, draw: a custom form, check: further checks, open: other names are allowed too, title: the name of the key
 * here}. */
export const HINTS = {
  "plan.groups.*": { items: NAMES.nodes },
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
  "plan.outcomes.*": { draw: learnedForm(({ probabilities }) => problemOfSum(probabilities)) },
  "plan.outcomes.*.probabilities": {
    keys: (state) => ["", ...NAMES.transitions(state)],
    start: () => 0,
  },
  "plan.failures": { keys: NAMES.actionPlaces, start: () => ({ probability: 0.1 }) },
  "plan.failures.*": { draw: learnedForm() },
  "plan.own_times": { keys: NAMES.robots, start: () => ({}) },
  "plan.rates": {
    keys: NAMES.timed,
    start: (state, name) => ({
      rate: state.net.transitions.find((it) => it.name === name)?.rate ?? 1,
    }),
  },
  "plan.rates.*": { draw: learnedForm() },
  "plan.events": { keys: NAMES.timed, start: () => ({}), keepEmpty: true },
  "plan.events.*": { whole: true },
  "plan.events.*.settings": { data: true },
  "plan.tasks.queues": { items: NAMES.resources },
  "plan.tasks.done": { items: NAMES.transitions },
  "plan.parameters": { data: true },
  "plan.robots": { draw: robotsForm },
  "plan.on_lost": { draw: lostRule },
  "plan.subnets": {
    draw: () => h("p.muted", "Generated; to edit it, open the subnet."),
  },
};
for (const [pattern, hint] of Object.entries(HINTS))
  if (/^plan\.(durations|outcomes|failures)\b/.test(pattern))
    HINTS[pattern.replace("plan.", "plan.own_times.*.")] = hint;
