// The firing log: latest first, filtered by transition, robot or place. The arrow keys move through its lines; Enter
// shows the net after the selected firing.

import { h, $, seconds, LIST_STEPS } from "./dom.js";
import { courseOf } from "./course.js";
import { firingExtras } from "./reacting.js";
import { RestingList } from "./resting_list.js";

const ROWS = 120;
const PAUSE = 150; // ms between two drawings

/** Fires "visit" (detail n) when a line is chosen. */
export class FiringLog extends RestingList {
  constructor(model) {
    super($("log"), PAUSE);
    this.model = model;
    this.filter = $("log-filter");
    this.filter.value = "";
    this.filter.oninput = () => this.update();
    this.chosen = null; // number of the event whose line is selected
    this.list.onclick = (event) => {
      const row = event.target.closest("li[data-n]");
      if (row) this.visit(Number(row.dataset.n));
    };
    this.list.onkeydown = (event) => this.key(event);
    this.update();
  }

  visit(n) {
    this.choose(n);
    this.dispatchEvent(new CustomEvent("visit", { detail: n }));
  }

  key(event) {
    const rows = [...this.list.querySelectorAll("li[data-n]")];
    if (!rows.length) return;
    const steps = LIST_STEPS[event.key];
    const at = rows.findIndex((row) => Number(row.dataset.n) === this.chosen);
    if (steps)
      this.choose(
        Number(rows[Math.max(0, Math.min(rows.length - 1, at < 0 ? 0 : at + steps))].dataset.n),
      );
    else if (event.key === "Enter" && at >= 0) this.visit(this.chosen);
    else return;
    event.preventDefault();
    event.stopPropagation();
  }

  choose(n) {
    this.chosen = n;
    this.mark()?.scrollIntoView({ block: "nearest" });
  }

  /** Highlight the selected line, if it is drawn. */
  mark() {
    this.list.querySelector("[aria-selected]")?.removeAttribute("aria-selected");
    this.list.removeAttribute("aria-activedescendant");
    const row =
      this.chosen === null ? null : this.list.querySelector(`li[data-n="${this.chosen}"]`);
    if (!row) return null;
    row.setAttribute("aria-selected", "true");
    this.list.setAttribute("aria-activedescendant", row.id);
    return row;
  }

  say(event) {
    const scene = this.model.sceneOf(event);
    if (event.k === "plan") return `— the team now follows the plan “${event.name}” —`;
    if (event.k === "fire") {
      const moves = event.m.map(([robot, from, to]) => {
        const ends = [
          from === null ? "appears" : "",
          to === null ? "→ ends" : `→ ${scene.places[to].name}`,
        ]
          .filter(Boolean)
          .join(" ");
        return `${robot} ${ends}`;
      });
      const { cause, tasks } = firingExtras(event);
      const what = [...moves, ...tasks].join(", ");
      return `${scene.transitions[event.tr].name}${cause}${what ? `   ${what}` : ""}`;
    }
    if (event.k === "mark") return `— ${event.why}${event.restart ? ": time starts again" : ""} —`;
    if (event.k === "note") return `${event.robot ? `${event.robot}: ` : ""}${event.text}`;
    if (event.k === "status" && event.status.ended) return `— ended: ${event.status.ended} —`;
    if (event.k === "status" && event.status.paused !== undefined)
      return event.status.paused ? "— the team is paused —" : "— the team resumes —";
    return null;
  }

  draw() {
    const { model } = this;
    if (!model.board) return;
    const wanted = this.filter.value.trim().toLowerCase();
    const course = courseOf(model, true);
    const rows = [];
    let past = false; // whether the line is from before the last reset
    for (let i = course.length - 1; i >= 0 && rows.length < ROWS; i--) {
      const event = course[i];
      const earlier = past;
      past = past || Boolean(event.restart);
      const text = this.say(event);
      if (text === null || (wanted && !text.toLowerCase().includes(wanted))) continue;
      const kind = event.k === "note" ? (event.level === "fault" ? "fault" : "note") : event.k;
      rows.push(
        h(
          "li",
          {
            role: "option",
            id: `log-${event.n}`,
            class: `${kind}${earlier ? " past" : ""}`,
            "data-n": event.n,
            title: text,
          },
          h("time", seconds(event.t)),
          h("span.what-happened", text),
        ),
      );
    }
    if (!rows.length)
      rows.push(
        h(
          "li.nothing",
          { role: "option", "aria-disabled": "true" },
          h("time"),
          h("span.what-happened.muted", wanted ? "no match" : "nothing has fired yet"),
        ),
      );
    this.list.replaceChildren(...rows);
    this.mark();
  }
}
