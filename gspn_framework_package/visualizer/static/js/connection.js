// Shows the state of the connection to the server, and reacts when it is lost or restored.

import { $, announceNow, attempt, clock, plural, seconds } from "./dom.js";
import { get, post } from "./api.js";
import { notice } from "./notice.js";

const NOT_HEARD = ["lost", "gone", "locked"]; // connection states in which no news arrives

export class Connection {
  constructor(page) {
    this.page = page;
    this.state = "waiting";
    this.lostSince = null; // a Date
    this.ranBefore = null; // {epoch, name} of the run that was on when another server answered
    this.announced = null; // the state that a screen reader was last given
    setInterval(() => this.show(), 500);
  }

  change(state, heard, why) {
    const lost = NOT_HEARD.includes(state);
    const back = !lost && this.page.model.lostAt !== null;
    this.state = state;
    if (lost && this.page.model.lostAt === null)
      this.lostSince = new Date(Date.now() - (performance.now() - heard));
    this.page.model.setHeard(lost ? heard : null);
    this.page.showRun();
    this.show();
    if (back) this.askWhoIsThere();
    if (state === "gone")
      notice(`This net is no longer open on the server: ${why}.`, [
        ["Open it again", () => this.openAgain()],
      ]);
  }

  async openAgain() {
    const { id } = this.page.model.session;
    if (id.startsWith("file-"))
      await attempt(() => post("open", { path: id.slice("file-".length) }));
    await this.page.open(id);
  }

  take(news) {
    const { model } = this.page;
    const ran =
      model.mode === "LIVE" && model.head.status.running
        ? { epoch: model.epoch, name: model.head.status.run || "" }
        : null;
    model.take(news);
    if (ran && model.lostAt !== null && model.epoch !== ran.epoch) this.ranBefore = ran;
  }

  /** After a lost connection: find out whether the server was restarted, and what happened to the run. */
  async askWhoIsThere() {
    const { model } = this.page;
    const before = this.page.hello;
    const hello = await get("hello").catch(() => null);
    if (!hello || this.page.model !== model) return;
    this.page.hello = hello;
    const ran = this.ranBefore;
    this.ranBefore = null;
    if (hello.server === before.server && !ran) return;
    const cut = this.cutOff(hello, model.session.id);
    const again = `The server was restarted (no contact since ${clock(this.lostSince)}).`;
    if (cut || (ran && !model.head.status.running))
      this.tellCut(`${again} The run ${ran?.name ? `“${ran.name}” ` : ""}was cut off.`, cut);
    else notice(again);
  }

  /** The run of this plan that was cut off when the server ended, if any. */
  cutOff(hello, key) {
    return (hello.cut || []).find(({ path }) => key === `file-${path}`);
  }

  tellCut(says, cut) {
    const offers = cut?.log
      ? [
          [
            "Replay its log",
            () => attempt(async () => this.page.go((await post("open", { path: cut.log })).id)),
          ],
        ]
      : [];
    if (cut) {
      const place = cut.log ? "its log" : "its log, outside the served folder";
      const verb = cut.events === 1 ? "is" : "are";
      says = `${says} ${plural(cut.events, "event")} of it ${verb} in ${place}.`;
    }
    notice(says, offers);
  }

  show() {
    const pill = $("connection");
    if (!this.page.model) {
      pill.hidden = true;
      return;
    }
    pill.hidden = false;
    const since = this.lostSince ? ` since ${clock(this.lostSince)}` : "";
    const words = {
      waiting: "connecting",
      open: "connected",
      polling: "connected (polling)",
      lost: `connection lost${since}, reconnecting`,
      gone: "no longer open on the server",
      locked: "the server needs a token",
    };
    pill.dataset.state = this.state === "gone" || this.state === "locked" ? "lost" : this.state;
    let text = words[this.state];
    if (pill.dataset.state === "lost" && this.announced !== this.state) announceNow(text);
    else if (this.announced && pill.dataset.state !== "lost" && this.state !== "waiting")
      announceNow(text);
    this.announced = pill.dataset.state === "lost" ? this.state : null;
    if (
      this.page.model.mode === "LIVE" &&
      this.page.model.lastEvent !== null &&
      (this.state === "open" || this.state === "polling")
    ) {
      text = `last event ${seconds((performance.now() - this.page.model.lastEvent) / 1000)} ago`;
    }
    if (!this.page.model.following && this.page.model.mode === "LIVE")
      text = `view paused · ${text}`;
    pill.querySelector("span").textContent = text;
  }
}
