// The firing log: the latest first, filtered by transition, robot or place.

import { h, $, seconds } from "./dom.js";

const ROWS = 120;

/** Fires "visit" (detail n) when a line is chosen. */
export class FiringLog extends EventTarget {
  constructor(model) {
    super();
    this.model = model;
    this.list = $("log");
    this.filter = $("log-filter");
    this.filter.value = "";
    this.filter.oninput = () => this.update();
    this.list.onclick = (event) => {
      const row = event.target.closest("li[data-n]");
      if (row) this.dispatchEvent(new CustomEvent("visit", { detail: Number(row.dataset.n) }));
    };
    this.update();
  }

  later() {
    if (!this.timer) this.timer = setTimeout(() => this.update(), Math.max(150, 25 * (this.cost || 0)));
  }

  say(event) {
    const { scene } = this.model;
    if (event.k === "fire" || event.k === "undo") {
      const moves = event.m.map(([robot, from, to]) => {
        const ends = [from === null ? "appears" : "", to === null ? "→ ends" : `→ ${scene.places[to].name}`].filter(Boolean).join(" ");
        return `${robot} ${ends}`;
      });
      return `${scene.transitions[event.tr].name}${moves.length ? `   ${moves.join(", ")}` : ""}`;
    }
    if (event.k === "mark") return `— ${event.why} —`;
    if (event.k === "note") return `${event.robot ? `${event.robot}: ` : ""}${event.text}`;
    if (event.k === "status" && event.status.ended) return `— ended: ${event.status.ended} —`;
    if (event.k === "status" && event.status.paused !== undefined) return event.status.paused ? "— the team is paused —" : "— the team goes on —";
    return null;
  }

  update() {
    clearTimeout(this.timer);
    this.timer = 0;
    const { model } = this;
    if (!model.board) return;
    const begun = performance.now();
    const wanted = this.filter.value.trim().toLowerCase();
    const rows = [];
    for (let i = model.indexAfter(model.board.n) - 1; i >= 0 && rows.length < ROWS; i--) {
      const event = model.events[i];
      const text = this.say(event);
      if (text === null || (wanted && !text.toLowerCase().includes(wanted))) continue;
      const kind = event.k === "note" ? (event.level === "fault" ? "fault" : "note") : event.k;
      rows.push(h("li", { class: kind, "data-n": event.n, title: text }, h("time", { text: seconds(event.t) }), h("span", { class: "what-happened", text })));
    }
    if (!rows.length) rows.push(h("li", {}, h("time"), h("span", { class: "what-happened muted", text: wanted ? "nothing like that" : "nothing has fired yet" })));
    this.list.replaceChildren(...rows);
    this.cost = performance.now() - begun;
  }
}
