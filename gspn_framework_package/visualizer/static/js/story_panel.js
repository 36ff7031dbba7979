// The story of a run: who waited for whom and why, and what happened; each moment can be shown on the net.

import { h, $, refill, attempt, seconds, table, toast } from "./dom.js";
import { get } from "./api.js";

const ROUNDED = 0.0006; // s by which times of the story may be too early
const KINDS = { intervention: "order", task_end: "task ended" };
const LISTED = { wait: "waits", failure: "failures", alarm: "alarms", intervention: "orders" };

/** Fires "light" (detail: the name of a place) when a moment there is shown. */
export class StoryPanel extends EventTarget {
  constructor(model) {
    super();
    this.model = model;
    this.body = $("story");
    this.story = null;
    this.only = ""; // the kind of what is listed; "": all
    this.body.replaceChildren();
  }

  close() {
    this.closed = true;
  }

  /** Ask for the story, unless it is known and the run is over. */
  async open(anew = false) {
    if (this.asking || (this.story && !anew)) return;
    this.asking = true;
    refill(this.body, h("p.muted", "Reading the log …"));
    try {
      this.story = await get("story", { id: this.model.session.id });
    } catch (error) {
      this.story = null;
      if (!this.closed) refill(this.body, h("p.muted", error.message));
      return;
    } finally {
      this.asking = false;
    }
    if (!this.closed) this.draw();
  }

  draw() {
    const { story, model } = this;
    const goes = model.mode === "LIVE" && model.head.status.running;
    const query = new URLSearchParams({ id: model.session.id });
    refill(
      this.body,
      h(
        "div.story-head",
        h("a.button", {
          href: `/api/report?${query}`,
          download: true,
          text: "Report",
          title: "One HTML file, to look at and to send",
        }),
        goes && h("button", { text: "Read on", onclick: () => this.open(true) }),
        h("span.muted", `${seconds(story.seconds)}, ${story.firings} firings`),
      ),
      h("h3", "Who was waited for"),
      story.waited_for.length
        ? table(
            "table.story-awaited",
            ["Robot", h("th", "Others waited"), h("th", "Waits")],
            story.waited_for.map((row) => [row.robot, seconds(row.seconds), row.waits]),
          )
        : h("p.muted", "No robot waited for another."),
      h("h3", "What happened"),
      this.kinds(),
      h("ol.story-list", this.rows()),
      story.left_out > 0 && h("p.muted", `${story.left_out} more in the whole log.`),
    );
  }

  /** The buttons that narrow the list to a kind. */
  kinds() {
    const choose = (kind) => () => {
      this.only = this.only === kind ? "" : kind;
      this.draw();
      this.body.querySelector(`[data-kind="${kind}"]`).focus();
    };
    const button = ([kind, text]) =>
      h("button.small", {
        "data-kind": kind,
        "aria-pressed": String(this.only === kind),
        text,
        onclick: choose(kind),
      });
    return h("div.story-kinds", Object.entries(LISTED).map(button));
  }

  /** Waits and moments, in their order. */
  rows() {
    const waits = this.story.waits.map((wait) => ({ ...wait, at: wait.t, kind: "wait" }));
    return [...waits, ...this.story.moments]
      .filter(({ kind }) => !this.only || kind === this.only)
      .sort((a, b) => a.at - b.at)
      .map((moment) => this.row(moment));
  }

  row(moment) {
    const where = [moment.robot || "the team", moment.place].filter(Boolean).join(", ");
    const detail = moment.detail ? `: ${moment.detail}` : "";
    const text = moment.kind === "wait" ? `${moment.robot} ${moment.text}` : `${where}${detail}`;
    return h(
      "li",
      { class: moment.kind },
      h("button.link", {
        text: seconds(moment.at) || "0 s",
        title: "Show this moment",
        onclick: () => attempt(() => this.show(moment)),
      }),
      h("span", h("span.badge", KINDS[moment.kind] || moment.kind), ` ${text}`),
    );
  }

  /** Show a moment; a wait is shown at its beginning. */
  async show(moment) {
    const shown = await this.model.showTime(moment.at + ROUNDED);
    if (shown === false) toast("this moment has not been read yet");
    else if (moment.place) this.dispatchEvent(new CustomEvent("light", { detail: moment.place }));
  }
}
