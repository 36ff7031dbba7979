// Compares a computed policy with the present one: in words and tables, and highlighted on the net.

import { $, facts, h, natural, number, plural, question, table, LIST_STEPS } from "./dom.js";
import { mark, unmark } from "./net_marks.js";
import { choiceText, percent } from "./policy_table.js";

const SENSITIVITIES = 12;

const precise = (value) =>
  typeof value === "number" ? String(Number(value.toPrecision(10))) : String(value ?? "–");
const signed = (value) => `${value > 0 ? "+" : ""}${number(value)}`;
/** A marking in words, with marked places only. */
export const markingText = (counts) =>
  Object.entries(counts)
    .filter(([, count]) => count)
    .sort(([a], [b]) => natural(a, b))
    .map(([name, count]) => `${name}: ${count}`)
    .join(", ") || "no token anywhere";
const alike = (a, b) => {
  const names = Object.keys(a);
  return names.length === Object.keys(b).length && names.every((name) => a[name] === b[name]);
};

const gainText = (gain) =>
  Math.abs(gain) < 5e-7
    ? "none: the present policy is already optimal"
    : `${gain > 0 ? "+" : ""}${percent(gain)}`;

const sentences = (list) =>
  h(
    "ul.reasons",
    list.map((text) => h("li", text)),
  );

/** The parts of an answer. */
export class OptimiseViews {
  /** `node(name)`: a link to a place or transition. */
  constructor(node) {
    this.node = node;
  }

  worth(value, { unit }) {
    return typeof value === "number" ? `${number(value)}${unit ? ` ${unit}` : ""}` : String(value);
  }

  /** The further settings of the request, in words. */
  asked({ never, may_wait: waiting, uncertain, timing, fitted }) {
    const rates = Object.entries(uncertain).map(
      ([name, [low, high]]) => `${name} from ${number(low)} to ${number(high)} per second`,
    );
    return [
      never.length && `Never ${never.join("; never ")}`,
      waiting.length && `Robots may wait in ${[...waiting].sort(natural).join(", ")}`,
      rates.length && `Best for the worst rates of ${rates.join(", ")}`,
      `Time as ${timing === "run" ? "the plan runs" : "in the net alone"}`,
      fitted ? "Rates as learned, where the plan has them" : "Rates of the net",
    ]
      .filter(Boolean)
      .map((text) => `${text}.`)
      .join(" ");
  }

  /** Compare present and best. */
  result(answer) {
    const { objective, present_policy: present, gain, simulation } = answer;
    const known = (value) => value !== null && value !== undefined;
    const rows = [
      [
        "Present policy",
        known(present.value)
          ? this.worth(present.value, objective)
          : h("span.muted", `not known: ${present.why || "no reason given"}`),
      ],
      [
        "Best policy",
        known(answer.value)
          ? h("strong", this.worth(answer.value, objective))
          : h("span.badge.warn", "none"),
      ],
      ["Gain", known(gain) ? gainText(gain) : "–"],
    ];
    const interval = `between ${precise(answer.lower)} and ${precise(answer.upper)}`;
    const bounds =
      typeof answer.lower !== "number" || typeof answer.upper !== "number"
        ? "There is no certified interval for the best value."
        : answer.exact === false
          ? `By simulation, its value is ${interval}; whether there is a better one is not known.`
          : `The best possible value is certified to be ${interval}.`;
    const waits = answer.silent
      ? ` In ${plural(answer.silent, "case")} robots let those in another place choose first, which takes no time.`
      : "";
    return question(
      "Present and best",
      true,
      h("p", "Aim: ", objective.text, "."),
      h("p.muted", this.asked(answer.asked)),
      facts(rows),
      h("p", bounds),
      simulation && h("p", "Simulated as executed: ", simulation.text, "."),
      h("p.muted", `The new policy has ${plural(answer.rows, "row")}.${waits}`),
      answer.undecided.length > 0 && [
        h("p", h("span.badge.warn", "not decided")),
        sentences(answer.undecided),
      ],
    );
  }

  teams({ teams, objective }) {
    if (teams.length < 2) return null;
    return question(
      "Teams",
      false,
      h("p.muted", "Choices are also computed for the smaller teams after losses."),
      table(
        "table",
        ["Robots", "States", "Value", "Best from", "to"],
        teams.map((team) => [
          String(team.robots),
          team.states.toLocaleString("en"),
          team.value === null ? team.why || "none" : this.worth(team.value, objective),
          precise(team.lower),
          precise(team.upper),
        ]),
      ),
    );
  }

  constraints({ constraints, objective }) {
    if (!constraints.length) return null;
    return question(
      "Constraints",
      true,
      table(
        "table",
        ["Constraint", "At least", "Reached", "Costs"],
        constraints.map(({ name, value, bound, price }) => [
          bound === null ? `never ${name}` : this.node(name),
          bound === null ? "" : number(bound),
          bound === null ? "" : number(value),
          price === null || price === undefined
            ? "not known"
            : price === 0
              ? "nothing"
              : this.worth(price, objective),
        ]),
      ),
      h(
        "p.muted",
        "The cost of a condition: the gain without it, or with a bound that is lower by 1.",
      ),
    );
  }

  sensitivities({ sensitivities }) {
    const size = ({ elasticity, derivative }) => Math.abs(elasticity ?? derivative ?? 0);
    const known = [...sensitivities].sort((a, b) => size(b) - size(a));
    if (!known.length) return null;
    return question(
      "Sensitivity of the value",
      false,
      h("p.muted", "The change of the value if a transition becomes 1 % faster."),
      table(
        "table",
        ["Transition", "Rate (1/s)", "Change"],
        known
          .slice(0, SENSITIVITIES)
          .map(({ transition, rate, elasticity, derivative }) => [
            this.node(transition),
            number(rate),
            typeof elasticity === "number"
              ? `${signed(Number(elasticity.toPrecision(4)))} %`
              : `${signed(0.01 * rate * derivative)}`,
          ]),
      ),
      known.length > SENSITIVITIES && h("p.muted", `and ${known.length - SENSITIVITIES} more`),
    );
  }

  assumptions({ assumptions, simulation }) {
    const notes = (simulation?.notes || []).filter((note) => !assumptions.includes(note));
    if (!assumptions.length && !notes.length) return null;
    return question(
      "Assumptions",
      false,
      sentences(assumptions),
      notes.length > 0 && [h("p", "In the simulation:"), sentences(notes)],
    );
  }
}

/** The listed choices: the arrow keys go through them, and the selected one is shown on the net. */
export class ChoiceList {
  /** `show(choice)` is called with the selected one. */
  constructor(answer, show) {
    this.choices = answer.choices;
    this.show = show;
    this.list = h(
      "ul",
      { id: "op-choices", role: "listbox", tabindex: "0", "aria-label": "Choices" },
      this.choices.map((choice, i) => this.item(choice, i)),
    );
    this.list.onkeydown = (event) => {
      const steps = LIST_STEPS[event.key];
      if (!steps || !this.choices.length) return;
      event.preventDefault();
      event.stopPropagation();
      const at = this.at === undefined ? (steps > 0 ? -1 : 0) : this.at;
      this.select(Math.max(0, Math.min(this.choices.length - 1, at + steps)));
    };
    this.list.onclick = (event) => {
      const item = event.target.closest("li[data-at]");
      if (item) this.select(Number(item.dataset.at));
    };
    const listed = this.choices.length;
    const { choices_in_all: all, choices_that_differ: differing } = answer;
    const differ = `${differing.toLocaleString("en")} of ${all.toLocaleString("en")} ${
      differing === 1 ? "differs" : "differ"
    }${all > listed ? `; ${listed.toLocaleString("en")} are listed` : ""}`;
    this.element = question(
      "Choices",
      true,
      h(
        "p.muted",
        this.choices.length
          ? `${differ}. Select one to see it on the net.`
          : "No robot ever has a choice.",
      ),
      this.choices.length > 0 && this.list,
    );
  }

  item({ marking, place, present, best, loss }, i) {
    const same = alike(present, best);
    return h(
      "li",
      { role: "option", id: `op-choice-${i}`, "data-at": i, "aria-selected": "false" },
      h("span.where", h("strong", place), ` when ${markingText(marking)}: `),
      same
        ? `${choiceText(best)}, as now`
        : [`now ${choiceText(present)} → best ${choiceText(best)}`],
      !same && typeof loss === "number" && loss > 0 && h("span.muted", `; loses ${number(loss)}`),
    );
  }

  select(at) {
    this.clear();
    this.at = at;
    const item = this.list.children[at];
    item.setAttribute("aria-selected", "true");
    this.list.setAttribute("aria-activedescendant", item.id);
    item.scrollIntoView({ block: "nearest" });
    this.show(this.choices[at]);
  }

  clear() {
    this.list.querySelector("[aria-selected='true']")?.setAttribute("aria-selected", "false");
    this.list.removeAttribute("aria-activedescendant");
  }
}

/** Highlights choices on the net: present and best differ in line style and wording. */
export class ChoicePainter {
  constructor(view) {
    this.view = view;
    this.legend = h("span.legend-words");
  }

  /** Whether the present highlighting comes from here. */
  get on() {
    return $("legend").contains(this.legend) && !$("legend").hidden;
  }

  /** `choices`: [{place, present, best}], `present` is null if unknown. `title` says which marking they are for. */
  paint(choices, title) {
    const marks = [];
    for (const { place, present, best } of choices) {
      const waits = [
        present && !Object.keys(present).length && "present",
        best && !Object.keys(best).length && "best",
      ].filter(Boolean);
      const text = waits.length ? `${waits.join(" and ")}: wait` : "";
      marks.push([place, { kind: "mark", text }]);
      for (const name of new Set([...Object.keys(best), ...Object.keys(present || {})])) {
        const [now, then] = [present?.[name], best[name]];
        const said = [
          now !== undefined && ["present", now],
          then !== undefined && ["best", then],
        ].filter(Boolean);
        const kind = said.length === 2 ? "both" : said[0][0];
        marks.push([name, { kind, text: this.words(said) }]);
      }
    }
    const sign = (kind) => h("span", { class: `key-sign ${kind}`, "aria-hidden": "true" });
    this.legend.replaceChildren(
      h("strong", title),
      sign("present"),
      h("span", "present (dashed)"),
      sign("best"),
      h("span", "best (solid)"),
    );
    mark(this.view, marks, this.legend);
  }

  words(said) {
    const shown = (probability) => (probability === 1 ? "" : ` ${percent(probability)}`);
    if (said.length === 2 && said[0][1] === said[1][1])
      return `present and best${shown(said[0][1])}`;
    return said.map(([who, probability]) => `${who}${shown(probability)}`).join(", ");
  }

  clear() {
    if (this.on) unmark(this.view);
  }
}
