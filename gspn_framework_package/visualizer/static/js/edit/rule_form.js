// What the team does when an action fails, or when a robot is lost.

import { NAMES } from "./names.js";
import { problemOf, resolved, typeOf } from "./schema.js";

/** A rule that tries again, as an object. */
const retryOf = (rule) =>
  typeOf(rule) === "object" ? rule : { retry: Number(String(rule).split(" ")[1]) };

/** wait, stop, retry N, fire T, {retry, delay}. */
export function failureRule(form, lens, title) {
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
    (it) => retryOf(it).retry,
    (n, it) => (typeOf(it) === "object" ? { ...it, retry: n } : `retry ${n}`),
    "retry",
  );
  const delay = lens.as(
    (it) => retryOf(it).delay,
    (seconds, it) => {
      const { retry } = retryOf(it);
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
export function lostRule(form, lens, title, schema) {
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
