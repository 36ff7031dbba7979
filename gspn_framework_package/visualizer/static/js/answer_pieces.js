// The pieces that answers of the analysis are made of, and what of them is highlighted on the net.

import { h, number, plural, question, table, $ } from "./dom.js";
import { barPlot, CURVES } from "./plot.js";
import { FiringSequence, sequenceControls } from "./sequence.js";

const YES = { true: ["yes", "good"], false: ["no", "bad"] };
export const LIST = 60; // names listed; the rest is counted
const ROWS = 400; // rows of a table; the rest is left out

export class AnswerPieces {
  constructor(model, view, choose) {
    this.model = model;
    this.view = view;
    this.choose = choose;
    this.stage = null; // where the firing sequences in an answer are played (sequence.js)
    this.places = new Map(model.scene.places.map((p, i) => [p.name, i]));
    this.transitions = new Map(model.scene.transitions.map((t, i) => [t.name, i]));
  }

  section(title, ...content) {
    return question(title, true, ...content);
  }

  answer(result, key, value = result[key]) {
    if (value === null || value === undefined)
      return [h("span.badge.warn", "not decided"), ` ${this.why(result, key)}`];
    if (typeof value === "boolean")
      return h("span", { class: `badge ${YES[value][1]}`, text: YES[value][0] });
    return number(value);
  }

  why(result, key) {
    return (result.undecided || {})[key] || "";
  }

  /** The measures of a part that have a title but no special layout. */
  titled(result, part) {
    return Object.entries(result.titles?.[part] || {}).map(([key, title]) => {
      const value = result[key];
      if (Array.isArray(value)) return [title, this.names(value)];
      if (value && typeof value === "object")
        return [
          title,
          Object.entries(value)
            .map(([name, one]) => `${name} ${typeof one === "number" ? number(one) : one}`)
            .join(", "),
        ];
      return [title, typeof value === "string" ? value : this.answer(result, key)];
    });
  }

  node(name) {
    const kind = this.places.has(name) ? "place" : "transition";
    const index = (kind === "place" ? this.places : this.transitions).get(name);
    return index === undefined
      ? name
      : h("button.link", {
          text: name,
          onclick: () => this.choose({ kind, index, fly: true }),
        });
  }

  names(list) {
    if (!list.length) return "none";
    return [
      list.slice(0, LIST).map((name, i) => [i ? ", " : "", this.node(name)]),
      list.length > LIST ? ` and ${list.length - LIST} more` : "",
    ];
  }

  way(steps) {
    if (!steps) return null;
    const fired = steps.filter((name) => this.transitions.has(name)); // when time passes in steps, robots wait too
    const { mode, session } = this.model;
    return h(
      "div",
      this.wayText(steps),
      fired.length > 0 &&
        (mode === "SIMULATE" || session.simulable) &&
        sequenceControls(new FiringSequence(fired, this.stage)),
    );
  }

  wayText(steps) {
    return h(
      "p.muted",
      steps.length
        ? [
            "By firing ",
            steps.slice(0, LIST).map((name, i) => [i ? " → " : "", this.node(name)]),
            steps.length > LIST ? ` … (${plural(steps.length, "step")})` : "",
          ]
        : "It holds at the start.",
    );
  }

  markingText(counts) {
    const there = Object.entries(counts).filter(([, count]) => count);
    return there.length
      ? there.map(([name, count]) => `${name}: ${count}`).join(", ")
      : "no token anywhere";
  }

  marking(counts) {
    return counts ? h("p.muted", this.markingText(counts)) : null;
  }

  /** The answers to the conditions of a question, each drawn by `draw`; or the reason why there is none. */
  conditions(result, key, draw) {
    const why = Object.entries(result.undecided ?? {})
      .filter(([name]) => name.startsWith(`${key}.`))
      .map(([, text]) => text);
    return (result[key] || []).map((found) => (found ? draw(found) : h("p", why)));
  }

  /** A button that highlights a result on the net and shows a legend for it. */
  painter(label, title, marks, ramp = null) {
    return h("button", {
      text: label,
      onclick: () => {
        this.view.paint({ places: marks.places || {}, transitions: marks.transitions || {} });
        $("legend").replaceChildren(
          h("strong", title),
          ...(ramp ? [h("span", number(ramp[0])), h("span.ramp"), h("span", number(ramp[1]))] : []),
          h("button.icon.small", {
            "aria-label": "Clear highlighting",
            text: "×",
            onclick: () => this.unpaint(),
          }),
        );
        $("legend").hidden = false;
      },
    });
  }

  unpaint() {
    this.view.paint(null);
    $("legend").hidden = true;
  }

  marked(names, kind) {
    const marks = { places: {}, transitions: {} };
    for (const name of names) {
      if (this.places.has(name)) marks.places[this.places.get(name)] = { kind };
      else if (this.transitions.has(name)) marks.transitions[this.transitions.get(name)] = { kind };
    }
    return marks;
  }

  heat(values) {
    const marks = { places: {}, transitions: {} };
    const most = Math.max(...Object.values(values).filter(Number.isFinite), 0);
    for (const [name, value] of Object.entries(values)) {
      if (!Number.isFinite(value)) continue;
      const mark = {
        kind: "heat",
        level: most ? value / most : 0,
        text: number(Number(value.toPrecision(3))),
      };
      if (this.places.has(name)) marks.places[this.places.get(name)] = mark;
      else if (this.transitions.has(name)) marks.transitions[this.transitions.get(name)] = mark;
    }
    return [marks, [0, most]];
  }

  /** A table whose first column holds text or elements, and whose others hold numbers. */
  table(head, rows, kind = "table") {
    return table(kind, head, rows.slice(0, ROWS));
  }

  /** The legend of the curves. */
  key(names) {
    return h(
      "p.key",
      names.map((name, i) => {
        const dot = h("b", "● ");
        dot.style.color = CURVES[i % CURVES.length];
        return h("span", dot, name);
      }),
    );
  }

  /** Bars of the distribution of a place's token count; the user chooses the place. */
  distribution(byPlace) {
    const names = Object.keys(byPlace);
    if (!names.length) return null;
    const chosen = h(
      "select",
      { "aria-label": "Place" },
      names.map((name) => h("option", { value: name, text: name })),
    );
    const bars = h("div");
    chosen.onchange = () =>
      bars.replaceChildren(
        barPlot(
          Object.entries(byPlace[chosen.value])
            .filter(([, p]) => p > 5e-7)
            .slice(0, 30),
        ),
      );
    chosen.onchange();
    return [h("h3", "Distribution of tokens"), chosen, bars];
  }
}
