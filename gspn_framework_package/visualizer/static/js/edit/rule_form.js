// The forms for failures of actions and for lost robots.

import { NAMES } from "./names.js";
import { problemOf, resolved, typeOf } from "./schema.js";
import { blankOf, objectForm } from "./schema_form.js";

/** A rule that tries again, as an object. */
const retryOf = (rule) =>
  typeOf(rule) === "object" ? rule : { retry: Number(String(rule).split(" ")[1]) };

/** wait, stop, retry N, fire T, {retry, delay}, and the objects that other packages have added. */
export function failureRule(form, lens, title) {
  const value = lens.get();
  const place = lens.name;
  const [, retry, ...added] = form.schema.properties.on_failure.additionalProperties.oneOf;
  const nameOf = ({ required }) => required[0];
  const own = typeOf(value) === "object" && added.find((it) => nameOf(it) in value);
  const plain = typeOf(value) === "object" ? "retry" : String(value).split(" ")[0];
  const kind = own ? nameOf(own) : plain;
  const leaving = place === "*" ? NAMES.transitions(form.state) : NAMES.leaving(form.state, place);
  const START = { wait: "wait", stop: "stop", retry: "retry 3", fire: `fire ${leaving[0] ?? ""}` };
  for (const it of added) START[nameOf(it)] = blankOf(it, form.schema);
  const kinds = [
    ["wait", "wait for the operator"],
    ["stop", "stop the team"],
    ["retry", "try again"],
    ...(leaving.length || kind === "fire" ? [["fire", "fire a transition"]] : []),
    ...added.map((it) => [nameOf(it), it.title]),
  ];
  const times = lens.as(
    (it) => retryOf(it).retry,
    (n, it) => (typeOf(it) === "object" ? { ...it, retry: n } : `retry ${n}`),
    "retry",
  );
  const delay = lens.as(
    (it) => retryOf(it).delay,
    (seconds, it) => {
      const { retry: count } = retryOf(it);
      return seconds === undefined ? `retry ${count}` : { retry: count, delay: seconds };
    },
    "delay",
  );
  const rule = resolved(retry, form.schema);
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
    own && ownRule(form, lens, title, own),
  ];
}

function ownRule(form, lens, title, schema) {
  const whole = form.whole(lens, (value) => problemOf(schema, value, form.schema));
  return [objectForm(form, schema, whole, title), form.verdict(whole)];
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
