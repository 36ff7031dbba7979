// The alarms above the net: robots that need the operator, and problems of the team or its run.

import { $, ask, h, plural } from "./dom.js";
import { alarming } from "./phases.js";

/** The alarms of a model, worst first: [[text, class, those that follow from it, its size], ...]; `status`: of its
 * team. */
function alarmsOf(model, status) {
  const alarms = [];
  const robots = [...(model.mode === "REPLAY" ? model.board : model.head).robots.values()];
  const alarm = (text, kind = "", follows = [], size = "") =>
    alarms.push([text, kind, follows, size]);
  for (const [phase, { word }] of alarming()) {
    const names = robots.filter((robot) => robot.phase === phase).map((robot) => robot.name);
    if (names.length) alarm(`${word[0].toUpperCase()}${word.slice(1)}: ${names.join(", ")}`);
  }
  if (status.stalled) alarm(`Stalled: ${status.stalled}`);
  if (status.unreachable) alarm(`Cut off: ${status.unreachable}`);
  if (model.mode === "LIVE")
    for (const { text, size, follows } of model.latest.model?.causes || [])
      alarm(text, "warning", follows, size);
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
    const texts = JSON.stringify(alarms);
    if (texts === this.shown) return;
    this.shown = texts;
    $("alarms").replaceChildren(
      ...alarms.map(([text, kind, follows, size]) => {
        const open = (event) => this.open(event.currentTarget, follows, size);
        const attributes = { class: `alarm ${kind}`, title: text, onclick: open };
        const more = follows.length > 0 && ` – ${plural(follows.length, "other")} from it`;
        // the size changes every second, which a screen reader should not announce
        const now = size && h("span", { "aria-hidden": "true" }, ` – by now ${size}`);
        return h("button", attributes, h("span", text, more, now));
      }),
    );
  }

  clear() {
    this.shown = "";
    $("alarms").replaceChildren();
  }

  /** Show the robots, and the full text of an alarm that was shortened, or that others follow from. */
  open(element, follows, size) {
    this.showTab("robots");
    const text = element.firstChild;
    if (text.scrollHeight <= text.clientHeight + 2 && !follows.length) return;
    const whole = [
      h("p.whole", element.title),
      size && h("p", `Estimated change since then: ${size}.`),
      follows.length > 0 && h("p.muted", "From the same cause:"),
      follows.map((one) => h("p.whole", one)),
    ];
    ask("Alarm", whole, [["Close", "", "primary"]]);
  }
}
