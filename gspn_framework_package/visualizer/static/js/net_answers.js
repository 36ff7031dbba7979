// Answers about the markings of a net or plan: its structure, its behaviour, what can be reached.

import { facts, h, number, plural } from "./dom.js";
import { LIST } from "./answer_pieces.js";

/** Marks of the same kind for some nodes. */
const marked = (names, kind) => names.map((name) => [name, { kind }]);

export function structure(show, result) {
  const sum = (weights) =>
    Object.entries(weights)
      .map(([name, weight]) => `${weight === 1 ? "" : `${weight}·`}${name}`)
      .join(" + ");
  const line = (title, names, kind, says) =>
    h("p", show.painter("show", title.slice(0, 160), marked(names, kind)), ` ${says}`);
  const sets = (title, key, say, members, kind) => {
    const found = result[key];
    if (!found) return [h("h3", title), h("p", show.answer(result, key))];
    const one = title.replace(/s$/, "");
    return [
      h("h3", `${title} (${found.length})`),
      found
        .slice(0, LIST)
        .map((item) => line(`${one}: ${say(item)}`, members(item), kind, say(item))),
      found.length > LIST && h("p.muted", `and ${found.length - LIST} more`),
    ];
  };
  const conflicts = result.conflict_sets?.filter((c) => c.length > 1);
  const classes = Object.entries(result.classes || {})
    .filter(([, is]) => is)
    .map(([name]) => name.replace(/_/g, " "));
  return show.section(
    "Structure",
    facts([
      ["Conservative", show.answer(result, "conservative")],
      ["Strictly", show.answer(result, "strictly_conservative")],
      ["Consistent", show.answer(result, "consistent")],
      ["Repetitive", show.answer(result, "repetitive")],
      ["Class", classes.join(", ") || "general"],
      ...show.titled(result, "structure"),
    ]),
    sets(
      "P-invariants",
      "place_invariants",
      (i) => `${sum(i.weights)} = ${i.value}`,
      (i) => Object.keys(i.weights),
      "mark",
    ),
    sets(
      "T-invariants",
      "transition_invariants",
      (i) => sum(i.weights),
      (i) => Object.keys(i.weights),
      "mark",
    ),
    sets(
      "Siphons",
      "siphons",
      (s) => `${s.places.join(", ")}${s.marked ? "" : " (empty)"}`,
      (s) => s.places,
      "bad",
    ),
    sets(
      "Traps",
      "traps",
      (t) => `${t.places.join(", ")}${t.marked ? " (marked)" : ""}`,
      (t) => t.places,
      "good",
    ),
    conflicts && [
      h("h3", `Conflicts (${conflicts.length})`),
      conflicts.slice(0, LIST).map((c) => line("Transitions in conflict", c, "mark", c.join(", "))),
    ],
  );
}

/** How time was interpreted, and what was assumed; nothing for a net. */
function timeFacts(show, timing, body) {
  if (!timing || !body.policy) return [];
  const split = Object.keys(timing.splits);
  return [
    ["Time", timing.reading === "run" ? "as the plan runs" : "as in its net alone"],
    split.length > 0 && ["Doing and done distinguished in", show.names(split)],
    timing.assumptions.length > 0 && ["Assumed", assumed(timing)],
  ];
}

/** The assumptions about time. */
export function assumed(timing) {
  return h(
    "ul",
    timing.assumptions.map((text) => h("li", text)),
  );
}

export function behaviour(show, result, body) {
  const { states, deadlocks } = result;
  const live = Object.entries(result.liveness || {});
  const dead = result.dead_transitions;
  const home = result.home_states,
    without = home?.without.length ? `without ${home.without.join(", ")}` : "";
  return show.section(
    body.policy ? "Behaviour under the policy" : "Behaviour",
    facts([
      [
        "States",
        states
          ? `${states.total.toLocaleString("en")} (${states.tangible.toLocaleString("en")} tangible)`
          : show.answer(result, "states"),
      ],
      states && ["Arcs", states.arcs.toLocaleString("en")],
      ["Bounded", show.answer(result, "bounded")],
      result.k_safe !== null &&
        result.k_safe !== undefined && [
          "k-safe",
          result.k_safe === "infinite" ? "no" : `${result.k_safe}-safe`,
        ],
      [
        "Deadlocks",
        !deadlocks
          ? show.answer(result, "deadlocks")
          : deadlocks.count === 0
            ? h("span.badge.good", "none")
            : [
                h(
                  "span.badge.bad",
                  deadlocks.count === null ? "at least one" : plural(deadlocks.count, "marking"),
                ),
                " ",
              ],
      ],
      ["Live", show.answer(result, "live")],
      [
        "Reversible",
        [
          show.answer(result, "reversible"),
          result.reversible === false && without && home.count === states.total
            ? ` (${without}: yes)`
            : "",
        ],
      ],
      [
        "Home states",
        home
          ? `${number(home.count)}${without && ` (${without})`}`
          : show.answer(result, "home_states"),
      ],
      ["Dead transitions", dead ? show.names(dead) : show.answer(result, "dead_transitions")],
      ...show.titled(result, "behaviour"),
      ...timeFacts(show, result.timing, body),
      result.left_out?.length > 0 && ["Left out", `${result.left_out.join(", ")}: only written to`],
      [
        "Limits",
        `${number(result.limits.states)} markings, ${number(result.limits.tree)} nodes of a tree, ` +
          `${number(result.limits.structure)} steps for invariants, siphons and traps; ` +
          `${number(result.limits.seconds)} s and ${number(result.limits.memory_bytes / 1e9)} GB for each part`,
      ],
    ]),
    deadlocks?.marking && [
      h("h3", "A deadlock"),
      show.marking(deadlocks.marking),
      show.way(deadlocks.witness),
    ],
    h(
      "div.buttons",
      dead?.length > 0 &&
        show.painter(
          "Show the dead transitions",
          "Transitions that never fire",
          marked(dead, "bad"),
        ),
      live.length > 0 &&
        show.painter(
          "Show liveness",
          "Live (L4): green; dead (L0): red",
          live.map(([name, level]) => [
            name,
            { kind: level === "L4" ? "good" : level === "L0" ? "bad" : "mark", text: level },
          ]),
        ),
      result.bounds &&
        show.painter(
          "Show the bounds",
          "Most tokens in each place",
          Object.entries(result.bounds).map(([name, bound]) => [
            name,
            {
              kind: bound === "infinite" ? "bad" : "heat",
              level: 0,
              text: bound === null ? "?" : bound === "infinite" ? "∞" : String(bound),
            },
          ]),
        ),
    ),
  );
}

export function reach(show, result) {
  return show.section(
    "Reachable?",
    show.conditions(result, "reach", (found) => [
      h(
        "p",
        show.answer(result, `reach.${found.condition}`, found.reachable),
        ` ${found.condition}`,
        found.count ? ` — in ${plural(found.count, "marking")}` : "",
      ),
      show.marking(found.marking),
      show.way(found.witness),
    ]),
  );
}

export function cover(show, result) {
  return show.section(
    "Coverable?",
    show.conditions(result, "cover", (found) => [
      h(
        "p",
        show.answer(result, `cover.${found.condition}`, found.coverable),
        ` ${found.condition}`,
      ),
      show.marking(found.marking),
      show.way(found.witness),
    ]),
  );
}

const VERDICTS = { proven: "good", violated: "bad" };

/** The answer about all markings: one if it is the same when robots are lost, else two. */
export function decided(show, answers) {
  return show.section(
    "In all markings?",
    answers.map(({ verdict, statement, losses, steps, marking, sequence }) => [
      h(
        "p",
        h("span", { class: `badge ${VERDICTS[verdict] ?? "warn"}`, text: verdict }),
        ` ${statement}`,
      ),
      show.marking(marking),
      sequence?.length > 0 && (losses ? show.wayText(sequence) : show.way(sequence)),
      h("p.muted", steps.map(({ name, outcome }) => `${name}: ${outcome}`).join("; ")),
    ]),
  );
}
