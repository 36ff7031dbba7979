// The analysis panel: sends questions to the server, shows the progress, and highlights the results on the net.

import { $, h, number, plural, question, toast } from "./dom.js";
import { AnswerPieces } from "./answer_pieces.js";
import { answersTo } from "./answers.js";
import { BackgroundJob } from "./jobs.js";
import { sweepFields, sweepOf } from "./sweep.js";

/** The question of a request in readable words. */
function questionText(request) {
  const { reach, cover, mean_time_to: condition, at, settling, rewards, simulate, sweep } = request;
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
    const field = (id, label, input) => [h("label", { for: id, text: label }), input];
    const text = (id, placeholder) =>
      h("input", { id, type: "text", placeholder, spellcheck: "false", autocomplete: "off" });
    const ask = (label, request) =>
      h("button", { text: label, onclick: () => this.ask(request, label) });
    this.settings = {
      limit: h("input", { id: "an-limit", type: "number", min: 1, max: 2000000, value: 100000 }),
      seconds: h("input", { id: "an-seconds", type: "number", min: 1, max: 120, value: 60 }),
      from: h(
        "select",
        { id: "an-from" },
        h("option", { value: "initial", text: "the initial marking" }),
        h("option", { value: "marking", text: "the current marking" }),
      ),
      reading: h(
        "select",
        { id: "an-reading" },
        h("option", { value: "run", text: "as the plan runs" }),
        h("option", { value: "net", text: "as in its net alone" }),
      ),
      policy: h("input", {
        id: "an-policy",
        type: "checkbox",
        checked: Boolean(plan),
      }),
    };
    const { policy, reading } = this.settings;
    policy.addEventListener("change", () => {
      reading.disabled = !policy.checked; // a net has no run
    });
    const reach = text("an-reach", "p1 >= 1 and p2 == 0, or deadlock");
    const cover = text("an-cover", "p1 = 2, p2 = 1");
    const passage = text("an-passage", "p2 >= 1");
    const until = h("input", { id: "an-until", type: "number", min: 0, step: "any", value: 20 });
    const points = h("input", { id: "an-points", type: "number", min: 2, max: 200, value: 60 });
    const settling = h("input", {
      id: "an-settling",
      type: "number",
      min: 0,
      step: "any",
      value: 0.001,
    });
    const rewards = text("an-rewards", "p1 = 0.5, t2 = 3");
    const runs = this.simulationFields(text);
    const sweep = sweepFields(text);
    const fields = (named) =>
      h(
        "div.form",
        ...Object.values(named).flatMap(({ label, input }) => field(input.id, label, input)),
      );
    const times = () => {
      const end = Math.max(0, Number(until.value) || 0),
        count = Math.max(2, Math.min(200, Math.round(Number(points.value)) || 2));
      return Array.from({ length: count }, (_, i) => (end * i) / (count - 1));
    };
    this.status = h("div.answer", { role: "status" });
    this.job = new BackgroundJob(this.model.session, this.status, "an-cancel");
    this.answers = h("div", { id: "answers" });
    this.panel.replaceChildren(
      this.refusal ? h("p.muted", `Analysis is not available: ${this.refusal}.`) : "",
      h(
        "div.buttons",
        h("button.primary", {
          id: "an-all",
          text: "Analyse",
          onclick: () => this.ask(() => ({ structure: true, timing: true }), "Analyse"),
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
          ...field("an-limit", "Max. states", this.settings.limit),
          ...field("an-seconds", "Max. seconds", this.settings.seconds),
          ...field("an-from", "Start from", this.settings.from),
          ...(plan
            ? [
                ...field("an-policy", "Under the policy", this.settings.policy),
                ...field("an-reading", "Time", this.settings.reading),
              ]
            : []),
        ),
      ),
      question(
        "Is it reachable?",
        false,
        h("div.form", ...field("an-reach", "Reachable", reach)),
        ask("Reachable?", () => ({ reach: [reach.value] })),
        h("div.form", ...field("an-cover", "Coverable", cover)),
        ask("Coverable?", () => ({ cover: [this.namedNumbers(cover.value, true)] })),
      ),
      question(
        "How long until?",
        false,
        h("div.form", ...field("an-passage", "Condition", passage)),
        ask("Mean time", () => ({ mean_time_to: [passage.value], at: times() })),
      ),
      question(
        "How does it evolve?",
        false,
        h(
          "div.form",
          ...field("an-until", "Until (s)", until),
          ...field("an-points", "Points", points),
          ...field("an-settling", "Settled within", settling),
        ),
        h(
          "div.buttons",
          ask("Tokens over time", () => ({ at: times() })),
          ask("Time to steady state", () => ({ settling: Number(settling.value) })),
        ),
      ),
      question(
        "What is it worth?",
        false,
        h("p.muted", "Reward per token and second in a place, or per firing of a transition."),
        h("div.form", ...field("an-rewards", "Rewards", rewards)),
        ask("Reward per second", () => ({
          timing: true,
          rewards: this.namedNumbers(rewards.value, false),
        })),
      ),
      question(
        "Simulated runs",
        false,
        h(
          "p.muted",
          "Many independent runs, with confidence intervals; also for unbounded nets and nets too large to analyse.",
        ),
        fields(runs),
        ask("Simulate runs", () => ({ simulate: this.simulationOf(runs) })),
      ),
      question(
        "Sweep",
        false,
        h(
          "p.muted",
          "The runs above for each value of robots, rate:TRANSITION, duration:, failure: or tokens:PLACE.",
        ),
        fields(sweep),
        ask("Sweep", () => ({ sweep: sweepOf(sweep, this.simulationOf(runs)) })),
      ),
      this.answers,
    );
  }

  simulationFields(text) {
    const numeric = (id, value, min, max = null) =>
      h("input", { id, type: "number", min, max, step: "any", value });
    return {
      time: { label: "Length (s)", input: numeric("an-sim-time", 100, 0) },
      until: { label: "Or until", input: text("an-sim-until", "p2 >= 1") },
      replications: { label: "Runs", input: numeric("an-sim-runs", 1000, 1, 100000) },
      warmup: { label: "Warm-up (s)", input: numeric("an-sim-warmup", 0, 0) },
      confidence: { label: "Confidence (%)", input: numeric("an-sim-confidence", 95, 1, 99.99) },
      seed: { label: "Seed", input: numeric("an-sim-seed", 0, 0) },
    };
  }

  simulationOf(fields) {
    const value = (key) => fields[key].input.value.trim();
    const simulate = {
      replications: Math.round(Number(value("replications"))),
      warmup: Number(value("warmup")),
      confidence: Number(value("confidence")) / 100,
      seed: Math.round(Number(value("seed"))),
    };
    if (value("time")) simulate.time = Number(value("time"));
    if (value("until")) simulate.until = value("until");
    return simulate;
  }

  /** "a = 1, b = 2" as {a: 1, b: 2}. */
  namedNumbers(text, whole) {
    const numbers = new Map();
    for (const part of text.split(/[,;]/).filter((p) => p.trim())) {
      const found = /^\s*(.*?)\s*(?:=|>=)\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)\s*$/i.exec(
        part,
      );
      if (!found || (whole && !/^\d+$/.test(found[2])))
        throw new Error(`'${part.trim()}' is not of the form name = number`);
      numbers.set(found[1].replace(/^['"]|['"]$/g, ""), Number(found[2]));
    }
    return Object.fromEntries(numbers);
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
    this.pieces.unpaint();
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
    const { limit, seconds: most, from, policy, reading } = this.settings;
    const plan = Boolean(this.model.scene.plan);
    const body = {
      ...request,
      limit: Math.round(Number(limit.value)),
      seconds: Number(most.value),
      from: from.value,
      policy: policy.checked && plan,
      ...(plan ? { reading: reading.value } : {}),
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
  }
}
