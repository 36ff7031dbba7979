// The alarms above the net: robots that need the operator, and problems of the team or its run.

import { $, ask, h } from "./dom.js";
import { alarming } from "./phases.js";

/** The alarms of a model, worst first: [[text, class], ...]. `status`: of its team. */
function alarmsOf(model, status) {
  const alarms = [];
  const robots = [...(model.mode === "REPLAY" ? model.board : model.head).robots.values()];
  const alarm = (text, kind = "") => alarms.push([text, kind]);
  for (const [phase, { word }] of alarming()) {
    const names = robots.filter((robot) => robot.phase === phase).map((robot) => robot.name);
    if (names.length) alarm(`${word[0].toUpperCase()}${word.slice(1)}: ${names.join(", ")}`);
  }
  if (status.stalled) alarm(`Stalled: ${status.stalled}`);
  if (status.unreachable) alarm(`Cut off: ${status.unreachable}`);
  if (model.mode === "LIVE")
    for (const text of model.latest.model?.alarms || []) alarm(text, "warning");
  if (status.paused) alarm("The team is paused", "warning");
  if (status.ended)
    alarm(
      `${status.fault ? "Failed" : status.finished ? "Finished" : "Ended"}: ${status.ended}`,
      status.fault ? "" : status.finished ? "good" : "warning",
    );
  return alarms;
}

export class Alarms {
  /** `showTab(name)`: opens a tab of the details. */
  constructor(showTab) {
    this.showTab = showTab;
    this.shown = ""; // the texts
  }

  show(model, status) {
    const alarms = alarmsOf(model, status);
    const texts = alarms.map(([text]) => text).join("\n");
    if (texts === this.shown) return;
    this.shown = texts;
    $("alarms").replaceChildren(
      ...alarms.map(([text, kind]) => {
        const open = (event) => this.open(event.currentTarget);
        const attributes = { class: `alarm ${kind}`, title: text, onclick: open };
        return h("button", attributes, h("span", text));
      }),
    );
  }

  clear() {
    this.shown = "";
    $("alarms").replaceChildren();
  }

  /** Show the robots, and the full text of an alarm that was shortened. */
  open(element) {
    this.showTab("robots");
    const text = element.firstChild;
    if (text.scrollHeight > text.clientHeight + 2)
      ask("Alarm", h("p.whole", text.textContent), [["Close", "", "primary"]]);
  }
}
