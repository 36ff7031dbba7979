// The results of an analysis: in words, tables and plots, and highlighted on the net.

import { h, number, plural, $ } from "./dom.js";
import { curvePlot, barPlot, CURVES } from "./plot.js";
import { FiringSequence, sequenceControls } from "./sequence.js";
import { sweepAnswer } from "./sweep.js";

const YES = { true: ["yes", "good"], false: ["no", "bad"] };
const LIST = 60;

export class AnswerViews {
  constructor(model, view, choose) {
    this.model = model;
    this.view = view;
    this.choose = choose;
    this.places = new Map(model.scene.places.map((p, i) => [p.name, i]));
    this.transitions = new Map(model.scene.transitions.map((t, i) => [t.name, i]));
  }

  /** `stage`: where the firing sequences in the answer are played (sequence.js). */
  all(result, request, body, stage) {
    this.stage = stage;
    if (request.simulate) return [this.simulated(result.simulation)].filter(Boolean);
    if (request.sweep) {
      const section = (title, ...content) => this.section(title, ...content);
      return [sweepAnswer(result.sweep, section, (names) => this.key(names))].filter(Boolean);
    }
    const parts = [];
    if (request.reach) parts.push(this.reach(result));
    if (request.cover) parts.push(this.cover(result));
    if (request.mean_time_to) parts.push(this.passage(result));
    if (request.at && !request.mean_time_to) parts.push(this.transient(result));
    if (request.settling !== undefined) parts.push(this.settling(result));
    if (request.structure) parts.push(this.structure(result));
    if (
      !request.reach &&
      !request.cover &&
      !request.mean_time_to &&
      !request.at &&
      request.settling === undefined &&
      result.bounded !== undefined
    )
      parts.push(this.behaviour(result, body));
    if (request.timing) parts.push(this.steady(result));
    return parts.flat().filter(Boolean);
  }

  // -- pieces --------------------------------------------------------------------------------------

  section(title, ...content) {
    return h(
      "details",
      { class: "question", open: true },
      h("summary", { text: title }),
      h("div", { class: "body" }, content),
    );
  }

  answer(result, key, value = result[key]) {
    if (value === null || value === undefined)
      return [h("span", { class: "badge warn", text: "not decided" }), ` ${this.why(result, key)}`];
    if (typeof value === "boolean")
      return h("span", { class: `badge ${YES[value][1]}`, text: YES[value][0] });
    return number(value);
  }

  why(result, key) {
    return (result.undecided || {})[key] || "";
  }

  facts(pairs) {
    return h(
      "dl",
      { class: "facts" },
      pairs.filter(Boolean).map(([name, value]) => [h("dt", { text: name }), h("dd", {}, value)]),
    );
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
      : h("button", {
          class: "link",
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
    const fired = steps.filter((name) => this.transitions.has(name)); // robots also wait in a step
    const { mode, session } = this.model;
    return h(
      "div",
      {},
      this.wayText(steps),
      fired.length > 0 &&
        (mode === "SIMULATE" || session.simulable) &&
        sequenceControls(new FiringSequence(fired, this.stage)),
    );
  }

  wayText(steps) {
    return h(
      "p",
      { class: "muted" },
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
    return counts ? h("p", { class: "muted", text: this.markingText(counts) }) : null;
  }

  /** A button that highlights a result on the net and explains it in the legend. */
  painter(label, title, marks, ramp = null) {
    return h("button", {
      text: label,
      onclick: () => {
        this.view.paint({ places: marks.places || {}, transitions: marks.transitions || {} });
        $("legend").replaceChildren(
          h("strong", { text: title }),
          ...(ramp
            ? [
                h("span", { text: number(ramp[0]) }),
                h("span", { class: "ramp" }),
                h("span", { text: number(ramp[1]) }),
              ]
            : []),
          h("button", {
            class: "icon small",
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

  table(head, rows) {
    return h(
      "table",
      {},
      h(
        "thead",
        {},
        h(
          "tr",
          {},
          head.map((text, i) => h("th", { class: i ? "number" : "", text })),
        ),
      ),
      h(
        "tbody",
        {},
        rows.slice(0, 400).map((row) =>
          h(
            "tr",
            {},
            row.map((cell, i) =>
              h("td", { class: i ? "number" : "" }, i ? number(cell) : this.node(cell)),
            ),
          ),
        ),
      ),
    );
  }

  // -- answers -------------------------------------------------------------------------------------

  structure(result) {
    const sum = (weights) =>
      Object.entries(weights)
        .map(([name, weight]) => `${weight === 1 ? "" : `${weight}·`}${name}`)
        .join(" + ");
    const sets = (title, key, say, members, kind) => {
      const found = result[key];
      if (!found) return [h("h3", { text: title }), h("p", {}, this.answer(result, key))];
      return [
        h("h3", { text: `${title} (${found.length})` }),
        found
          .slice(0, LIST)
          .map((item) =>
            h(
              "p",
              {},
              this.painter(
                "show",
                `${title.replace(/s$/, "")}: ${say(item)}`.slice(0, 160),
                this.marked(members(item), kind),
              ),
              ` ${say(item)}`,
            ),
          ),
        found.length > LIST && h("p", { class: "muted", text: `and ${found.length - LIST} more` }),
      ];
    };
    const classes = Object.entries(result.classes || {})
      .filter(([, is]) => is)
      .map(([name]) => name.replace(/_/g, " "));
    return this.section(
      "Structure",
      this.facts([
        ["Conservative", this.answer(result, "conservative")],
        ["Strictly", this.answer(result, "strictly_conservative")],
        ["Consistent", this.answer(result, "consistent")],
        ["Repetitive", this.answer(result, "repetitive")],
        ["Class", classes.join(", ") || "general"],
        ...this.titled(result, "structure"),
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
      result.conflict_sets && [
        h("h3", { text: `Conflicts (${result.conflict_sets.filter((c) => c.length > 1).length})` }),
        result.conflict_sets
          .filter((c) => c.length > 1)
          .slice(0, LIST)
          .map((c) =>
            h(
              "p",
              {},
              this.painter("show", "Transitions in conflict", this.marked(c, "mark")),
              ` ${c.join(", ")}`,
            ),
          ),
      ],
    );
  }

  /** How time was read, and what was assumed; nothing for a net. */
  timing(timing, body) {
    if (!timing || !body.policy) return [];
    const split = Object.keys(timing.splits);
    return [
      ["Time", timing.reading === "run" ? "as the plan runs" : "as in its net alone"],
      split.length > 0 && ["Doing and done distinguished in", this.names(split)],
      timing.assumptions.length > 0 && [
        "Assumed",
        h(
          "ul",
          {},
          timing.assumptions.map((text) => h("li", { text })),
        ),
      ],
    ];
  }

  behaviour(result, body) {
    const { states, deadlocks } = result;
    const live = Object.entries(result.liveness || {});
    const dead = result.dead_transitions;
    const home = result.home_states,
      without = home?.without.length ? `without ${home.without.join(", ")}` : "";
    return this.section(
      body.policy ? "Behaviour under the policy" : "Behaviour",
      this.facts([
        [
          "States",
          states
            ? `${states.total.toLocaleString("en")} (${states.tangible.toLocaleString("en")} tangible)`
            : this.answer(result, "states"),
        ],
        states && ["Arcs", states.arcs.toLocaleString("en")],
        ["Bounded", this.answer(result, "bounded")],
        result.k_safe !== null &&
          result.k_safe !== undefined && [
            "k-safe",
            result.k_safe === "infinite" ? "no" : `${result.k_safe}-safe`,
          ],
        [
          "Deadlocks",
          !deadlocks
            ? this.answer(result, "deadlocks")
            : deadlocks.count === 0
              ? h("span", { class: "badge good", text: "none" })
              : [
                  h("span", {
                    class: "badge bad",
                    text:
                      deadlocks.count === null
                        ? "at least one"
                        : plural(deadlocks.count, "marking"),
                  }),
                  " ",
                ],
        ],
        ["Live", this.answer(result, "live")],
        [
          "Reversible",
          [
            this.answer(result, "reversible"),
            result.reversible === false && without && home.count === states.total
              ? ` (${without}: yes)`
              : "",
          ],
        ],
        [
          "Home states",
          home
            ? `${number(home.count)}${without && ` (${without})`}`
            : this.answer(result, "home_states"),
        ],
        ["Dead transitions", dead ? this.names(dead) : this.answer(result, "dead_transitions")],
        ...this.titled(result, "behaviour"),
        ...this.timing(result.timing, body),
        result.left_out?.length > 0 && [
          "Left out",
          `${result.left_out.join(", ")}: only written to`,
        ],
        [
          "Limits",
          `${number(result.limits.states)} markings, ${number(result.limits.tree)} nodes of a tree, ` +
            `${number(result.limits.structure)} steps for invariants, siphons and traps; ` +
            `${number(result.limits.seconds)} s and ${number(result.limits.memory_bytes / 1e9)} GB for each part`,
        ],
      ]),
      deadlocks?.marking && [
        h("h3", { text: "A deadlock" }),
        this.marking(deadlocks.marking),
        this.way(deadlocks.witness),
      ],
      h(
        "div",
        { class: "buttons" },
        dead?.length > 0 &&
          this.painter(
            "Show the dead transitions",
            "Transitions that never fire",
            this.marked(dead, "bad"),
          ),
        live.length > 0 &&
          this.painter("Show liveness", "Live (L4): green; dead (L0): red", {
            transitions: Object.fromEntries(
              live.map(([name, level]) => [
                this.transitions.get(name),
                { kind: level === "L4" ? "good" : level === "L0" ? "bad" : "mark", text: level },
              ]),
            ),
          }),
        result.bounds &&
          this.painter("Show the bounds", "Most tokens in each place", {
            places: Object.fromEntries(
              Object.entries(result.bounds).map(([name, bound]) => [
                this.places.get(name),
                {
                  kind: bound === "infinite" ? "bad" : "heat",
                  level: 0,
                  text: bound === null ? "?" : bound === "infinite" ? "∞" : String(bound),
                },
              ]),
            ),
          }),
      ),
    );
  }

  steady(result) {
    const steady = result.steady_state;
    if (!steady)
      return this.section("Steady state", h("p", {}, this.answer(result, "steady_state", null)));
    const tokens = Object.entries(steady.mean_tokens),
      flows = Object.entries(steady.throughput);
    const waits = new Map(Object.entries(steady.mean_waiting_time || {}));
    const states = result.likely_states || [];
    const stay = ({ mean_stay: value }) => (value === "infinite" ? "forever" : number(value));
    const facts = this.titled(result, "timing");
    if (steady.reward !== undefined) facts.unshift(["Reward", `${number(steady.reward)} /s`]);
    return this.section(
      "Steady state",
      facts.length > 0 && this.facts(facts),
      steady.component_count > 1 && [
        h("p", {
          class: "muted",
          text:
            `The net ends up in one of ${steady.component_count} recurrent classes, ` +
            `${steady.deadlock_count} of them deadlocks.` +
            (steady.component_count > steady.components.length
              ? ` The ${steady.components.length} most probable:`
              : ""),
        }),
        h(
          "table",
          { class: "states" },
          h(
            "thead",
            {},
            h(
              "tr",
              {},
              h("th", { text: "Most of the time in" }),
              h("th", { class: "number", text: "probability" }),
              h("th", { class: "number", text: "states" }),
            ),
          ),
          h(
            "tbody",
            {},
            steady.components.map((part) =>
              h(
                "tr",
                {},
                h("td", {
                  text:
                    Object.entries(part.marking)
                      .map(([place, n]) => (n === 1 ? place : `${n} ${place}`))
                      .join(", ") || "empty",
                }),
                h("td", { class: "number", text: number(part.probability) }),
                h("td", {
                  class: "number",
                  text: part.deadlock ? "deadlock" : number(part.states),
                }),
              ),
            ),
          ),
        ),
      ],
      h(
        "div",
        { class: "buttons" },
        this.painter("Show mean tokens", "Mean number of tokens", ...this.heat(steady.mean_tokens)),
        this.painter("Show throughput", "Firings a second", ...this.heat(steady.throughput)),
      ),
      h("h3", { text: "Tokens" }),
      this.table(
        ["Place", "mean", "wait (s)"],
        tokens.map(([name, value]) => [name, value, waits.get(name) ?? null]),
      ),
      h("h3", { text: "Throughput (1/s)" }),
      this.table(["Transition", "firings"], flows),
      this.distribution(steady.token_distribution),
      states.length > 0 && [
        h("h3", { text: "The most probable markings" }),
        h(
          "table",
          { class: "states" },
          h(
            "thead",
            {},
            h(
              "tr",
              {},
              h("th", { text: "Marking" }),
              h("th", { class: "number", text: "probability" }),
              h("th", { class: "number", text: "mean stay (s)" }),
            ),
          ),
          h(
            "tbody",
            {},
            states.map((state) =>
              h(
                "tr",
                {},
                h("td", {}, this.markingText(state.marking)),
                h("td", {
                  class: "number",
                  text: number(Number(state.probability.toPrecision(4))),
                }),
                h("td", { class: "number", text: stay(state) }),
              ),
            ),
          ),
        ),
      ],
      h("p", { class: "muted", text: `Residual ${number(steady.residual)}.` }),
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
    return [h("h3", { text: "Distribution of tokens" }), chosen, bars];
  }

  simulated(found) {
    if (!found) return null;
    const digits = (value, count) => number(Number(value.toPrecision(count)));
    const estimate = (value) => {
      if (value === null) return "–";
      if (value.seen === false) {
        return `not seen${value.half_width === null ? "" : `, below ${digits(value.half_width, 2)}`}`;
      }
      const mean = value.mean === null ? number(null) : digits(value.mean, 4);
      if (value.half_width === 0) return `${mean} in every run`;
      return `${mean} ± ${value.half_width === null ? "?" : digits(value.half_width, 2)}`;
    };
    const means = (values) =>
      Object.fromEntries(Object.entries(values).map(([name, value]) => [name, value.mean]));
    const table = (head, values) =>
      h(
        "table",
        {},
        h(
          "thead",
          {},
          h(
            "tr",
            {},
            head.map((text, i) => h("th", { class: i ? "number" : "", text })),
          ),
        ),
        h(
          "tbody",
          {},
          Object.entries(values)
            .slice(0, 400)
            .map(([name, value]) =>
              h(
                "tr",
                {},
                h("td", {}, this.node(name)),
                h("td", { class: "number", text: estimate(value) }),
              ),
            ),
        ),
      );
    return this.section(
      "Results of the runs",
      this.facts([
        [
          "Runs",
          `${found.replications.toLocaleString("en")}${found.time === null ? "" : ` of ${number(found.time)} s`}`,
        ],
        found.warmup > 0 && ["Left out", `the first ${number(found.warmup)} s`],
        ["Firings", found.events.toLocaleString("en")],
        ["Confidence", `${number(100 * found.confidence)} %`],
        ["Seed", String(found.seed)],
        found.reached && ["Reached the condition", estimate(found.reached)],
        found.time_to_condition && ["Time to reach it (s)", estimate(found.time_to_condition)],
        found.reached && ["Length of a run (s)", estimate(found.end_time)],
      ]),
      h(
        "div",
        { class: "buttons" },
        this.painter(
          "Show mean tokens",
          "Mean number of tokens (simulated)",
          ...this.heat(means(found.mean_tokens)),
        ),
        this.painter(
          "Show throughput",
          "Firings a second (simulated)",
          ...this.heat(means(found.throughput)),
        ),
      ),
      h("h3", { text: "Tokens" }),
      table(["Place", "mean"], found.mean_tokens),
      h("h3", { text: "Throughput (1/s)" }),
      table(["Transition", "firings"], found.throughput),
      Object.entries(found.titles || {}).map(([key, title]) => [
        h("h3", { text: title }),
        table(["Subnet", "mean"], found[key]),
      ]),
      this.distribution(found.token_distribution),
    );
  }

  transient(result) {
    const found = result.transient;
    if (!found)
      return this.section("Tokens over time", h("p", {}, this.answer(result, "transient", null)));
    const names = Object.keys(found[0].mean_tokens);
    const swing = (name) => {
      const values = found.map((entry) => entry.mean_tokens[name]);
      return Math.max(...values) - Math.min(...values);
    };
    const order = [...names].sort((a, b) => swing(b) - swing(a));
    const shown = new Set(order.slice(0, 4));
    const plot = h("div");
    const draw = () =>
      plot.replaceChildren(
        curvePlot(
          [...shown].map((name) => ({
            name,
            points: found.map((entry) => [entry.time, entry.mean_tokens[name]]),
          })),
          "time (s)",
        ),
        this.key([...shown]),
      );
    const boxes = h(
      "div",
      { class: "choices" },
      order.slice(0, 60).map((name) =>
        h(
          "label",
          {},
          h("input", {
            type: "checkbox",
            checked: shown.has(name),
            onchange: (event) => {
              if (event.target.checked) shown.add(name);
              else shown.delete(name);
              draw();
            },
          }),
          ` ${name} `,
        ),
      ),
    );
    draw();
    return [
      this.section("Mean tokens over time", plot, boxes),
      this.section("Distribution of tokens over time", this.distributionOverTime(found, order)),
    ];
  }

  /** The probability of each token count of a chosen place, over time. */
  distributionOverTime(found, order) {
    const chosen = h(
      "select",
      { "aria-label": "Place whose distribution is shown" },
      order.map((name) => h("option", { value: name, text: name })),
    );
    const plot = h("div");
    chosen.onchange = () => {
      const name = chosen.value;
      const weight = new Map();
      for (const entry of found)
        for (const [count, p] of Object.entries(entry.token_distribution[name]))
          weight.set(count, Math.max(weight.get(count) || 0, p));
      const counts = [...weight]
        .filter(([, p]) => p > 0.005)
        .sort((a, b) => b[1] - a[1])
        .slice(0, CURVES.length)
        .map(([count]) => count)
        .sort((a, b) => a - b);
      const curves = counts.map((count) => ({
        name: `${plural(Number(count), "token")}`,
        points: found.map((entry) => [entry.time, entry.token_distribution[name][count] || 0]),
      }));
      plot.replaceChildren(
        curvePlot(curves, "time (s)"),
        this.key(curves.map((curve) => curve.name)),
      );
    };
    chosen.onchange();
    return [chosen, plot];
  }

  /** The legend of the curves. */
  key(names) {
    return h(
      "p",
      { class: "key" },
      names.map((name, i) => {
        const dot = h("b", { text: "● " });
        dot.style.color = CURVES[i % CURVES.length];
        return h("span", {}, dot, name);
      }),
    );
  }

  settling(result) {
    const value = result.time_to_steady_state;
    return this.section(
      "Time to steady state",
      h(
        "p",
        {},
        value === null
          ? this.answer(result, "time_to_steady_state", null)
          : value === "infinite"
            ? "never"
            : `${number(value)} s`,
      ),
    );
  }

  reach(result) {
    return this.section(
      "Reachable?",
      (result.reach || []).map((found) =>
        found
          ? [
              h(
                "p",
                {},
                this.answer(result, `reach.${found.condition}`, found.reachable),
                ` ${found.condition}`,
                found.count ? ` — in ${plural(found.count, "marking")}` : "",
              ),
              this.marking(found.marking),
              this.way(found.witness),
            ]
          : h(
              "p",
              {},
              Object.entries(result.undecided)
                .filter(([key]) => key.startsWith("reach."))
                .map(([, why]) => why),
            ),
      ),
    );
  }

  cover(result) {
    return this.section(
      "Coverable?",
      (result.cover || []).map((found) =>
        found
          ? [
              h(
                "p",
                {},
                this.answer(result, `cover.${found.condition}`, found.coverable),
                ` ${found.condition}`,
              ),
              this.marking(found.marking),
              this.way(found.witness),
            ]
          : h(
              "p",
              {},
              Object.entries(result.undecided)
                .filter(([key]) => key.startsWith("cover."))
                .map(([, why]) => why),
            ),
      ),
    );
  }

  passage(result) {
    return this.section(
      "How long until?",
      (result.mean_time_to || []).map((found) =>
        found
          ? [
              this.facts([
                ["Condition", found.condition],
                [
                  "Mean time",
                  found.mean_time === "infinite" ? "infinite" : `${number(found.mean_time)} s`,
                ],
                ["Probability", number(found.probability)],
              ]),
              found.within.length > 1 &&
                curvePlot(
                  [
                    {
                      name: "probability",
                      points: found.within.map((w) => [w.time, w.probability]),
                    },
                  ],
                  "within (s)",
                ),
            ]
          : h(
              "p",
              {},
              Object.entries(result.undecided)
                .filter(([key]) => key.startsWith("mean_time_to."))
                .map(([, why]) => why),
            ),
      ),
    );
  }
}
