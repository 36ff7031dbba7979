// The pieces that answers of the analysis are made of, and what of them is highlighted on the net.

import { h, menu, number, plural, question, table, rounded } from "./dom.js";
import { mark, nodeLink } from "./net_marks.js";
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

  /** The ends of the interval of an answer; null if it has none. */
  ends(result, key, name) {
    const found = result.intervals?.[key];
    return (Array.isArray(found) ? found : found?.[name]) ?? null;
  }

  /** The interval of an answer, to follow its number; empty if it has none. */
  within(result, key, name, digits = 4, to = " to ") {
    const ends = this.ends(result, key, name);
    if (!ends) return "";
    const [low, high] = ends.map((end) => rounded(end, digits));
    return ` (${low}${to}${high})`;
  }

  /** An answer in a table: its interval is below it, since names need the width. */
  cell(result, key, name, value) {
    const ends = this.within(result, key, name, 3, "–").trim();
    return [number(value), ends && h("div.muted", ends)];
  }

  /** Why answers have intervals, if they have; and which are not known. */
  whyIntervals(result, text = "In brackets: the intervals of the answers") {
    const { interval_sources: sources, intervals } = result;
    if (!sources) return null;
    const since = `, since ${sources.join(" and ")}.`;
    if (!intervals) return h("p.muted", `How far off the answers may be is not known yet${since}`);
    const gaps = Object.values(intervals).some((of) => !of || Object.values(of).includes(null));
    return h("p.muted", text + since + (gaps ? " Where none is shown, it is not known." : ""));
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
            .map(
              ([name, one]) =>
                `${name} ${typeof one === "number" ? number(one) : one}` +
                this.within(result, key, name),
            )
            .join(", "),
        ];
      const text = typeof value === "string" ? value : this.answer(result, key);
      return [title, [text, this.within(result, key)].flat()];
    });
  }

  node(name) {
    return nodeLink(this.model.scene, name, this.choose);
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
    const { mode, session, scene } = this.model;
    const known = new Set(scene.transitions.map(({ name }) => name));
    const fired = steps.filter((name) => known.has(name)); // when time passes in steps, robots wait too
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
    return (result[key] || []).map((found, i) => (found ? draw(found, i) : h("p", why)));
  }

  /** A button that marks nodes: [[name, mark], ...]; `legend` follows the title in the legend. */
  painter(label, title, marks, ...legend) {
    return h("button", {
      text: label,
      onclick: () => mark(this.view, marks, h("strong", title), ...legend),
    });
  }

  /** A button that colours nodes by their values. */
  heat(label, title, values) {
    const known = Object.entries(values).filter(([, value]) => Number.isFinite(value));
    const most = Math.max(...known.map(([, value]) => value), 0);
    const marks = known.map(([name, value]) => [
      name,
      {
        kind: "heat",
        level: most ? value / most : 0,
        text: rounded(value, 3),
      },
    ]);
    const ends = [0, most].map((value) => h("span", number(value)));
    return this.painter(label, title, marks, ends[0], h("span.ramp"), ends[1]);
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

  /** Bars of the distribution of a place's token count; the user chooses the place. `endsOf(place, count)`: the
   * interval of a probability. */
  distribution(byPlace, endsOf = () => null) {
    const names = Object.keys(byPlace);
    if (!names.length) return null;
    const bars = (name) =>
      barPlot(
        Object.entries(byPlace[name])
          .filter(([, p]) => p > 5e-7)
          .slice(0, 30)
          .map(([count, p]) => [count, p, endsOf(name, count)]),
      );
    return [h("h3", "Distribution of tokens"), this.chosen("Place", names, bars)];
  }

  /** A menu of names, and what `draw(name)` returns for the one chosen. */
  chosen(label, names, draw) {
    const shown = h("div");
    const choice = menu(names, { "aria-label": label });
    choice.onchange = () => shown.replaceChildren(...[draw(choice.value)].flat());
    choice.onchange();
    return [choice, shown];
  }
}
