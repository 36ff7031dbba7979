// The analysis panel: sends questions to the server, shows the progress, and highlights the results on the net.

import { $, h, labelled, menu, number, plural, question, refill, textField, toast } from "./dom.js";
import { AnswerPieces } from "./answer_pieces.js";
import { answersTo } from "./answers.js";
import { BackgroundJob } from "./jobs.js";
import { WhatIf } from "./what_if.js";
import { unmark } from "./net_marks.js";

const time = (value) => ({ type: "number", min: 0, step: "any", value });

/** The fields of the questions: the end of the id -> [label, attributes]. */
const FIELDS = {
  limit: ["Max. states", { type: "number", min: 1, max: 2000000, value: 100000 }],
  seconds: ["Max. seconds", { type: "number", min: 1, max: 120, value: 60 }],
  reach: ["Reachable", { placeholder: "p1 >= 1 and p2 == 0, or deadlock" }],
  cover: ["Coverable", { placeholder: "p1 = 2, p2 = 1" }],
  decide: ["About", {}],
  passage: ["Condition", { placeholder: "p2 >= 1" }],
  until: ["Until (s)", time(20)],
  points: ["Points", { type: "number", min: 2, max: 200, value: 60 }],
  settling: ["Settled within", time(0.001)],
  rewards: ["Rewards", { placeholder: "p1 = 0.5, t2 = 3" }],
  "sim-time": ["Length (s)", time(100)],
  "sim-until": ["Or until", { placeholder: "p2 >= 1" }],
  "sim-runs": ["Runs", { ...time(1000), min: 1, max: 100000 }],
  "sim-warmup": ["Warm-up (s)", time(0)],
  "sim-confidence": ["Confidence (%)", { ...time(95), min: 1, max: 99.99 }],
  "sim-seed": ["Seed", time(0)],
  "sweep-vary": ["Vary", { placeholder: "robots=1..5" }],
  "sweep-also": ["and", { placeholder: "rate:t1=0.5,1,2" }],
  "sweep-measure": ["Measure", { placeholder: "t1, p1 (default: throughputs)" }],
};

/** The questions about all markings: kind -> [label, what it is about]. */
const QUESTIONS = {
  dead: ["no marking is dead", ""],
  never: ["never holds", "p1 >= 1 and p2 == 0"],
  always: ["always holds", "p1 + p2 == 1"],
  returns: ["can hold again, from every marking", "p1 >= 1"],
  apart: ["no two tokens in", "At_*"],
  at_most: ["no more tokens than", "At_*=2"],
  fires: ["never fires", "t1"],
};

/** Those about plans alone. */
const QUESTIONS_OF_PLANS = {
  moves: ["no robot waits for ever", ""],
  no_row: ["the policy has a row for each decision", ""],
  ends: ["the plan can end, from every marking", ""],
};

/** "a, b" as ["a", "b"]. */
const listed = (text) =>
  text
    .split(",")
    .map((part) => part.trim())
    .filter(Boolean);

/** "a = 1, b = 2" as {a: 1, b: 2}. */
function namedNumbers(text, whole) {
  const numbers = new Map();
  for (const part of text.split(/[,;]/).filter((p) => p.trim())) {
    const found = /^\s*(.*?)\s*(?:=|>=)\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)\s*$/i.exec(part);
    if (!found || (whole && !/^\d+$/.test(found[2])))
      throw new Error(`'${part.trim()}' is not of the form name = number`);
    numbers.set(found[1].replace(/^['"]|['"]$/g, ""), Number(found[2]));
  }
  return Object.fromEntries(numbers);
}

/** The question of a request in readable words. */
function questionText(request) {
  const { reach, cover, mean_time_to: condition, at, settling, rewards, simulate, sweep } = request;
  const { decide } = request;
  const numbers = (named) =>
    Object.entries(named)
      .map(([name, value]) => `${name} = ${value}`)
      .join(", ");
  if (reach) return reach.join(", ");
  if (cover) return cover.map(numbers).join("; ");
  if (condition) return condition.join(", ");
  if (at) return `until ${number(at[at.length - 1])} s`;
  if (settling !== undefined) return `within ${number(settling)}`;
  if (rewards) return numbers(rewards);
  if (sweep) return sweep.vary.join(", ");
  if (decide)
    return [{ ...QUESTIONS, ...QUESTIONS_OF_PLANS }[decide.kind][0], decide.about]
      .filter(Boolean)
      .join(": ");
  if (simulate) {
    const length = simulate.time ? ` of ${number(simulate.time)} s` : "";
    const end = simulate.until ? `, until ${simulate.until}` : "";
    return plural(simulate.replications, "run") + length + end;
  }
  return "";
}

/** Fires "choose" (detail {kind, index, fly}). */
export class AnalysisPanel extends EventTarget {
  /** `stageFrom(marking)`: where firing sequences are played. `refusal`: why no analysis is possible; "" if one is. */
  constructor(model, view, stageFrom, refusal = "") {
    super();
    this.model = model;
    this.stageFrom = stageFrom;
    this.refusal = refusal;
    this.panel = $("analysis");
    this.pieces = new AnswerPieces(model, view, (detail) =>
      this.dispatchEvent(new CustomEvent("choose", { detail })),
    );
    this.build();
  }

  build() {
    const plan = this.model.scene.plan;
    const inputs = Object.entries(FIELDS).map(([name, [, attributes]]) => [
      name,
      textField({ id: `an-${name}`, ...attributes }),
    ]);
    this.inputs = Object.fromEntries(inputs);
    this.from = menu(
      [
        ["initial", "the initial marking"],
        ["marking", "the current marking"],
      ],
      { id: "an-from" },
    );
    this.reading = menu(
      [
        ["run", "as the plan runs"],
        ["net", "as in its net alone"],
      ],
      { id: "an-reading" },
    );
    this.policy = h("input", { id: "an-policy", type: "checkbox", checked: Boolean(plan) });
    this.policy.addEventListener("change", () => {
      this.reading.disabled = !this.policy.checked; // a net has no run
    });
    const kinds = { ...QUESTIONS, ...(plan && QUESTIONS_OF_PLANS) };
    this.kind = menu(
      Object.entries(kinds).map(([kind, [label]]) => [kind, label]),
      { id: "an-kind" },
    );
    const { decide } = this.inputs;
    const ofKind = () => {
      decide.placeholder = kinds[this.kind.value][1];
      decide.disabled = !decide.placeholder;
    };
    this.kind.addEventListener("change", ofKind);
    ofKind();
    const rows = (...names) => names.map((name) => labelled(FIELDS[name][0], this.inputs[name]));
    const form = (...names) => h("div.form", rows(...names));
    const ask = (label, request, attributes = {}) =>
      h("button", { text: label, onclick: () => this.ask(request, label), ...attributes });
    const says = (text) => h("p.muted", text);
    this.status = h("div.answer", { role: "status" });
    this.job = new BackgroundJob(this.model.session, this.status, "an-cancel");
    this.answers = h("div", { id: "answers" });
    this.whatIf = plan && !this.refusal ? new WhatIf(this.model) : null;
    refill(
      this.panel,
      this.refusal && says(`Analysis is not available: ${this.refusal}.`),
      h(
        "div.buttons",
        ask("Analyse", () => ({ structure: true, timing: true }), {
          id: "an-all",
          class: "primary",
        }),
        ask("Structure", () => ({ structure: true })),
        ask("State space", () => ({})),
        ask("Steady state", () => ({ timing: true })),
      ),
      this.status,
      question(
        "Settings",
        false,
        h(
          "div.form",
          rows("limit", "seconds"),
          labelled("Start from", this.from),
          plan && [labelled("Under the policy", this.policy), labelled("Time", this.reading)],
        ),
      ),
      question(
        "Is it reachable?",
        false,
        form("reach"),
        ask("Reachable?", () => ({ reach: [this.value("reach")] })),
        form("cover"),
        ask("Coverable?", () => ({ cover: [namedNumbers(this.value("cover"), true)] })),
      ),
      question(
        "Is it so in all markings?",
        false,
        says("Proven, also where the markings are too many to visit, or refuted by firings."),
        h("div.form", labelled("Question", this.kind), rows("decide")),
        ask("Decide", () => ({ decide: this.decision() })),
      ),
      question(
        "How long until?",
        false,
        form("passage"),
        ask("Mean time", () => ({ mean_time_to: [this.value("passage")], at: this.times() })),
      ),
      question(
        "How does it evolve?",
        false,
        form("until", "points", "settling"),
        h(
          "div.buttons",
          ask("Tokens over time", () => ({ at: this.times() })),
          ask("Time to steady state", () => ({ settling: Number(this.value("settling")) })),
        ),
      ),
      question(
        "What is it worth?",
        false,
        says("Reward per token and second in a place, or per firing of a transition."),
        form("rewards"),
        ask("Reward per second", () => ({
          timing: true,
          rewards: namedNumbers(this.value("rewards"), false),
        })),
      ),
      question(
        "Simulated runs",
        false,
        says(
          "Many independent runs, with confidence intervals; also for unbounded nets and nets too large to analyse.",
        ),
        form(...Object.keys(FIELDS).filter((name) => name.startsWith("sim-"))),
        ask("Simulate runs", () => ({ simulate: this.simulation() })),
      ),
      this.whatIf?.section,
      question(
        "Sweep",
        false,
        says(
          "The runs above for each value of robots, rate:TRANSITION, duration:, failure: or tokens:PLACE.",
        ),
        form("sweep-vary", "sweep-also", "sweep-measure"),
        ask("Sweep", () => ({ sweep: this.sweep() })),
      ),
      this.answers,
    );
  }

  /** The text in a field. */
  value(name) {
    return this.inputs[name].value.trim();
  }

  /** The times of a curve, in seconds. */
  times() {
    const end = Math.max(0, Number(this.value("until")) || 0),
      count = Math.max(2, Math.min(200, Math.round(Number(this.value("points"))) || 2));
    return Array.from({ length: count }, (_, i) => (end * i) / (count - 1));
  }

  decision() {
    return {
      kind: this.kind.value,
      about: this.inputs.decide.disabled ? "" : this.value("decide"),
    };
  }

  simulation() {
    const [length, until] = [this.value("sim-time"), this.value("sim-until")];
    return {
      replications: Math.round(Number(this.value("sim-runs"))),
      warmup: Number(this.value("sim-warmup")),
      confidence: Number(this.value("sim-confidence")) / 100,
      seed: Math.round(Number(this.value("sim-seed"))),
      ...(length && { time: Number(length) }),
      ...(until && { until }),
    };
  }

  sweep() {
    return {
      ...this.simulation(),
      vary: [this.value("sweep-vary"), this.value("sweep-also")].filter(Boolean),
      measure: listed(this.value("sweep-measure")),
    };
  }

  /** Ask the question that `read()` returns; `label`: the button pressed. Replaces the previous answer. */
  async ask(read, label) {
    if (this.refusal) {
      toast(`analysis is not available: ${this.refusal}`);
      return;
    }
    if (this.job.running) {
      toast("an analysis is running: wait for it or cancel it", true);
      return;
    }
    unmark(this.pieces.view);
    this.shownText = "";
    this.asked = h("p.asked", h("strong", label));
    this.answers.replaceChildren(this.asked);
    let request;
    try {
      request = read();
    } catch (error) {
      this.tellNoAnswer(error.message);
      this.status.replaceChildren();
      return;
    }
    const { from, policy, reading } = this;
    const plan = Boolean(this.model.scene.plan);
    const body = {
      ...request,
      limit: Math.round(Number(this.value("limit"))),
      seconds: Number(this.value("seconds")),
      from: from.value,
      policy: policy.checked && plan,
      ...(plan && { reading: reading.value }),
      event: this.model.board.n,
    };
    const stage = this.stageFrom(from.value === "initial" ? null : [...this.model.board.marking]);
    const about = h("span.muted");
    const tell = (start) => {
      about.textContent = [
        questionText(request),
        start,
        plan && (body.policy ? "under the policy" : "without the policy"),
      ]
        .filter(Boolean)
        .map((part) => ` · ${part}`)
        .join("");
    };
    tell(from.value === "initial" ? "from the initial marking" : "from the current marking");
    this.asked.append(about);
    try {
      const report = await this.job.run(body, {
        most: body.limit,
        started: ({ event }) => {
          if (body.from === "marking") tell(`from the marking after event ${event}`);
        },
        found: (result) => this.show(result, request, body, stage),
      });
      if (!report) return;
      if (report.state === "done" && !request.structure)
        this.answers.scrollIntoView({ block: "nearest" });
      if (report.state === "failed") this.tellNoAnswer(report.result ? "not to all of it" : "");
    } catch (error) {
      toast(error.message);
      this.tellNoAnswer("it did not start");
    }
  }

  /** Show below the question that there is no answer. */
  tellNoAnswer(why) {
    this.answers.append(h("p", h("span.badge.bad", "no answer"), why ? ` ${why}` : ""));
  }

  show(result, request, body, stage) {
    const text = JSON.stringify(result);
    if (text === this.shownText) return;
    this.shownText = text;
    this.pieces.stage = stage;
    this.answers.replaceChildren(this.asked, ...answersTo(this.pieces, result, request, body));
  }

  close() {
    this.job.close();
    this.whatIf?.close();
  }
}
