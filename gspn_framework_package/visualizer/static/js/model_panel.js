// Predicted against observed, in a live run: a prediction band with the observed line, and a strip for each place, each
// robot and the team that shows how close it is to its alarm.

import { h, menu, number, options } from "./dom.js";
import { band, Chart, showBands } from "./plot.js";

export class ModelPanel {
  constructor(model) {
    this.model = model;
    this.says = h("p.muted");
    this.choice = menu([], {
      "aria-label": "Firings to compare",
      "data-focus": "curve",
      onchange: () => this.draw(),
    });
    this.chart = new Chart();
    this.numbers = h("p.numbers");
    this.strips = h("ul.strips");
    this.stated = h("p.muted");
    this.body = h("div", this.choice, this.chart.element, this.numbers, this.strips, this.stated);
    this.section = h(
      "section.model-run",
      { "aria-label": "Predicted and observed" },
      h("h3", "Predicted and observed"),
      this.says,
      this.body,
    );
  }

  /** The section with the present state of the comparison; null if there is none. */
  element() {
    const reported = this.model.mode === "LIVE" ? this.model.latest.model : null;
    if (!reported) return null;
    if (reported !== this.reported) {
      this.reported = reported;
      this.update(reported);
    }
    return this.section;
  }

  update(reported) {
    this.say(this.says, `${reported.says[0].toUpperCase()}${reported.says.slice(1)}.`);
    this.body.hidden = !reported.curves;
    if (!reported.curves) return;
    const names = reported.curves.map(({ name }) => name);
    if (names.join("\n") !== this.names) {
      const kept = this.choice.value;
      this.names = names.join("\n");
      this.choice.replaceChildren(...options(names));
      this.choice.value = names.includes(kept) ? kept : names[0];
    }
    this.draw();
    this.strips.replaceChildren(...reported.streams.map((stream) => strip(stream)));
    this.say(
      this.stated,
      `One false alarm in ${number(reported.false_alarm_every / 86400)} days, over all strips together.`,
    );
  }

  draw() {
    const curve = this.reported.curves.find(({ name }) => name === this.choice.value);
    if (!curve || !curve.points.length) return;
    const [time, count] = curve.points[curve.points.length - 1],
      [low, high] = band(curve.growth, time);
    const line = { name: `${curve.name}, observed`, points: [[0, 0], ...curve.points] };
    const predicted = { name: "predicted", growth: curve.growth };
    showBands(this.chart, [predicted], line, Math.max(time, 1e-9));
    const where = count < low ? " – fewer than predicted" : count > high ? " – more" : "";
    this.say(
      this.numbers,
      `${number(count)} observed, ${number(Math.round(low))} to ${number(Math.round(high))} predicted (95 %)${where}`,
    );
  }

  say(element, text) {
    if (element.textContent !== text) element.textContent = text;
  }
}

/** A strip: how far a sum has risen towards its alarm. */
function strip({ kind, name, level, on, says }) {
  const percent = Math.round(100 * level),
    what = kind === "place" || kind === "robot" || kind === "team" ? name : `${name} (${kind})`;
  return h(
    "li",
    { class: on ? "on" : "" },
    h("span.name", { text: what, title: what }),
    h("meter", {
      min: 0,
      max: 1,
      low: 0.5,
      high: 0.8,
      optimum: 0,
      value: level,
      "aria-label": `${what}: ${percent} % of the way to the alarm`,
    }),
    h("span.level", on ? "alarm" : `${percent} %`),
    on && says ? h("span.says", says) : null,
  );
}
