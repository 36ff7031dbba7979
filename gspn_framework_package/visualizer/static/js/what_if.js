// *What if* there were more robots, or robots were slower or called away more often: sliders move a band of predicted
// firings. While one moves, a few short runs give a first look; when it rests, the exact mean follows where it can be
// computed, and a longer simulation. The page says which is shown.

import { h, labelled, menu, number, options, question, refill, rounded } from "./dom.js";
import { get, post } from "./api.js";
import { followJob } from "./jobs.js";
import { band, Chart, showBands } from "./plot.js";

const REST = 400; // ms without a change after which the longer simulation begins
const TIMES = 1; // the sliders of factors go from 10^-TIMES to 10^TIMES, in steps of STEP of the exponent
const STEP = 0.02;
const HORIZON = 600; // s shown where no run is observed
const ALL = "all transitions";

/** A factor as people read it. */
const times = (factor) => `× ${rounded(factor, 2)}`;

export class WhatIf {
  constructor(model) {
    this.model = model;
    this.says = h("p.muted", { role: "status" });
    this.chart = new Chart();
    this.chart.element.hidden = true;
    this.form = h("div.form.wi-form");
    this.section = question(
      "What if?",
      false,
      h(
        "p.muted",
        "How many firings the plan predicts (95 %): as it is, and with what the sliders change.",
      ),
      this.form,
      this.chart.element,
      this.says,
    );
    this.section.ontoggle = () => this.section.open && !this.known && this.open();
  }

  close() {
    this.closed = true;
    this.cancel();
  }

  get query() {
    return { id: this.model.session.id };
  }

  /** Ask what can be changed, and how the plan runs as it is. */
  async open() {
    try {
      this.known = await get("what_if", this.query);
      this.build();
      this.base = await post("what_if", {}, this.query);
    } catch (error) {
      this.known = null;
      this.says.textContent = error.message;
      return;
    }
    if (this.closed) return;
    const often = Object.entries(this.base.growth).sort(([, a], [, b]) => b[0] - a[0]);
    this.curve.replaceChildren(
      ...options([ALL, ...often.map(([name]) => name).filter((name) => name !== ALL)]),
    );
    this.show(this.base);
  }

  build() {
    const { robots, places, rates, each } = this.known;
    const slider = (id, attributes, reported) => {
      const value = h("output");
      const input = h("input", { id: `wi-${id}`, type: "range", ...attributes });
      const tell = () => {
        value.textContent = reported(Number(input.value));
        input.setAttribute("aria-valuetext", value.textContent);
      };
      input.oninput = () => {
        tell();
        this.changed();
      };
      tell();
      return { input, field: h("span.wi-slider", input, value) };
    };
    const factor = (id) =>
      slider(id, { min: -TIMES, max: TIMES, step: STEP, value: 0 }, (power) => times(10 ** power));
    const choice = (id, names, label) =>
      menu(names, {
        id: `wi-${id}`,
        "aria-label": label,
        onchange: () => this.changed(),
      });
    this.curve = menu([ALL], { id: "wi-curve", onchange: () => this.draw() });
    this.robots = slider(
      "robots",
      { min: 1, max: Math.max(2 * robots, robots + 4), value: robots },
      String,
    );
    this.slower = factor("slower");
    this.place = factor("place");
    this.placeName = choice("place-name", Object.keys(places), "Place");
    this.one = factor("one");
    this.oneName = choice("one-name", each, "Robot");
    this.rate = factor("rate");
    this.rateName = choice("rate-name", Object.keys(rates), "Event");
    const any = ({ value }, ...row) => value && row;
    refill(
      this.form,
      labelled("Show", this.curve),
      [h("label", { for: "wi-robots", text: "Robots" }), this.robots.field],
      [h("label", { for: "wi-slower", text: "All actions take" }), this.slower.field],
      any(this.placeName, this.placeName, this.place.field),
      any(this.oneName, this.oneName, this.one.field),
      any(this.rateName, this.rateName, this.rate.field),
    );
    this.place.input.setAttribute("aria-label", "Time of the action in this place");
    this.one.input.setAttribute("aria-label", "Time of the actions of this robot");
    this.rate.input.setAttribute("aria-label", "How often this event comes");
  }

  /** The request with the values of the sliders. */
  request() {
    const power = ({ input }) => 10 ** Number(input.value);
    const named = (menu_, slider) => (menu_.value ? { [menu_.value]: power(slider) } : {});
    return {
      robots: Number(this.robots.input.value),
      slower: power(this.slower),
      places: named(this.placeName, this.place),
      rates: named(this.rateName, this.rate),
      each: named(this.oneName, this.one),
    };
  }

  cancel() {
    clearTimeout(this.resting);
    const { job } = this;
    this.job = null;
    if (job) post(`analysis/${job}/cancel`, {}).catch(() => {});
  }

  /** A slider has moved: ask for another first look once the last one has arrived. */
  async changed() {
    this.cancel();
    this.wanted = this.request();
    if (this.looking) return;
    this.looking = true;
    try {
      while (this.wanted && !this.closed) {
        const asked = this.wanted;
        this.wanted = null;
        const look = await post("what_if", asked, this.query);
        if (!this.closed) this.show(look);
        if (!this.wanted) this.resting = setTimeout(() => this.whole(asked, look.next), REST);
      }
    } catch (error) {
      this.says.textContent = error.message;
    } finally {
      this.looking = false;
    }
  }

  /** The exact mean, and the longer simulation, of what is shown. */
  async whole(asked, next) {
    const answer = await post("what_if", { ...asked, whole: true, next }, this.query).catch(
      () => null,
    );
    if (!answer || this.looking || this.closed) return;
    this.job = answer.job;
    await followJob(answer.job, ({ result }) => {
      if (this.job !== answer.job) return true;
      const { exact, prediction } = result ?? {};
      if (JSON.stringify(exact) !== JSON.stringify(this.exact)) {
        this.exact = exact;
        this.draw();
      }
      if (prediction && !this.found.whole)
        this.show({ ...prediction, seconds: next.time, whole: true });
      return false;
    });
    if (this.job === answer.job) this.job = null;
  }

  show(found) {
    this.found = found;
    if (!found.whole) this.exact = null;
    this.draw();
  }

  /** The curve according to the Markov chain. */
  exactly(name, end) {
    const { states, throughput, half_widths: halves, notes, why } = this.exact || {};
    if (why) return ` No exact answer: ${why}.`;
    if (!throughput) return "";
    const count = (values) => {
      const chosen = name === ALL ? Object.values(values) : [values[name]];
      return chosen.includes(null) ? null : end * chosen.reduce((a, b) => a + b, 0);
    };
    const half = halves ? count(halves) : null;
    const off = half === null ? " give or take an unknown number" : ` ± ${rounded(half, 2)}`;
    const found = `${notes.length ? "About" : "Exactly"} ${number(count(throughput))}`;
    const how = [`Markov chain of ${number(states)} states`, ...notes].join("; ");
    return ` ${found}${notes.length && half !== 0 ? off : ""} on average in the long run (${how}).`;
  }

  draw() {
    const { found, base } = this;
    if (!found || !base) return;
    this.chart.element.hidden = false;
    const name = this.curve.value;
    const observed = this.model.latest.model?.curves?.find((curve) => curve.name === name);
    const line = observed?.points.length && {
      name: `${name}, observed`,
      points: [[0, 0], ...observed.points],
    };
    const end = line ? line.points.at(-1)[0] : HORIZON;
    const bands = [{ name: "as it is", growth: base.growth[name] }];
    if (found !== base)
      bands.push({ name: "what if", growth: found.growth[name], kind: "what-if" });
    showBands(this.chart, bands, line, Math.max(end, 1e-9));
    const span = (growth) =>
      band(growth, end)
        .map((count) => number(Math.round(count)))
        .join(" to ");
    const looked = `${found.runs} runs of ${number(found.seconds)} s`;
    const how = found.whole ? `Simulated: ${looked}.` : `First look: ${looked}.`;
    const changed = found === base ? "" : ` ${span(found.growth[name])} with the change.`;
    const counts = `After ${number(end)} s: ${span(base.growth[name])} as it is.${changed}`;
    this.says.textContent = `${how} ${counts}${this.exactly(name, end)}`;
    this.section.dataset.shows = found.whole ? "simulated" : "first look";
  }
}
