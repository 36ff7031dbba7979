// The robots as persons see them: colour and id, what each does and since when, why it waits.

import { h, $, seconds } from "./dom.js";
import { colourOf, shortName } from "./colours.js";

const PHASES = {
  doing: ["acts", "good"], done: ["waits", "warn"], waiting: ["waits", "warn"], failed: ["failed", "bad"], lost: ["lost", "bad"],
  left: ["has left", ""], inactive: ["has finished", ""],
};

/** What a robot is up to, in one word, and the kind of badge. */
export function phaseOf(robot) {
  if (robot.paused) return ["paused", "warn"];
  return PHASES[robot.phase] || ["", ""];
}

export function robotCard(model, robot, buttons = []) {
  const place = robot.place >= 0 ? model.scene.places[robot.place] : null;
  const [word, kind] = phaseOf(robot);
  const gone = robot.phase === "lost" || robot.phase === "left";
  const disc = h("span", { class: "disc", text: shortName(robot.name), "aria-hidden": "true" });
  disc.style.background = colourOf(robot.name);
  const feedback = model.following && !gone ? new Map(Object.entries(model.latest.feedback || {})).get(robot.name) : null;
  const since = robot.since !== undefined && robot.since !== null ? Math.max(0, model.now() - robot.since) : null;
  const attempt = robot.attempt > 1 ? `, attempt ${robot.attempt}` : "";
  return h("div", { class: `robot-card ${robot.phase || ""}`, "data-robot": robot.name }, disc,
    h("div", {},
      h("div", { class: "line" }, h("strong", { text: robot.name }), h("span", { class: `badge ${kind}`, text: word })),
      h("div", { class: "line muted" }, h("span", { text: place ? `${gone ? "was in " : ""}${place.name}${attempt}` : "" }), since !== null && !gone ? h("span", { class: "since", text: seconds(since) }) : null)),
    robot.why ? h("div", { class: "why", text: robot.why }) : null,
    feedback ? h("div", { class: "feedback", text: feedback }) : null,
    buttons.length > 0 && h("div", { class: "buttons" }, buttons));
}

/** Fires "operate" (detail {command, robot}). */
export class RobotsPanel extends EventTarget {
  constructor(model) {
    super();
    this.model = model;
    this.panel = $("robots");
    this.update();
    this.clock = setInterval(() => { if (!this.panel.hidden && model.mode === "LIVE") this.update(); }, 1000);
  }

  later() {
    if (!this.timer) this.timer = setTimeout(() => { this.timer = 0; this.update(); }, 250);
  }

  update() {
    if (this.panel.hidden || !this.model.board || this.panel.contains(document.activeElement) && document.activeElement.tagName === "BUTTON") return;
    const robots = [...this.model.board.robots.values()].sort((a, b) => a.name.localeCompare(b.name, undefined, { numeric: true }));
    if (!robots.length) {
      this.panel.replaceChildren(h("p", { class: "muted", text: this.model.mode === "SIMULATE"
        ? "A simulation moves tokens that have no name. Robots are seen in a live run or in a replay."
        : "No robot has been heard of yet." }));
      return;
    }
    const able = this.model.info.commands || [];
    this.panel.replaceChildren(...robots.map((robot) => robotCard(this.model, robot, this.model.mode === "LIVE" && this.model.following
      ? [robot.phase === "failed" && able.includes("retry") && this.button("Try again", "retry", robot)].filter(Boolean) : [])));
  }

  button(label, command, robot) {
    return h("button", { text: label, onclick: () => this.dispatchEvent(new CustomEvent("operate", { detail: { command, robot: robot.name } })) });
  }

  close() {
    clearInterval(this.clock);
    clearTimeout(this.timer);
  }
}
