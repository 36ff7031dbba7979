// Starts an analysis in the background on the server; shows its progress, a cancel button and its end.

import { h, attempt, seconds, pause } from "./dom.js";
import { get, post } from "./api.js";

const POLL = 250;

/** Follow an analysis: calls `seen(report)` whenever something is known, until it ends or `seen` returns true. Returns
 * its last report. */
export async function followJob(key, seen) {
  for (;;) {
    await pause(POLL);
    const report = await get(`analysis/${key}`).catch((error) => ({
      state: "failed",
      error: error.message,
      seconds: 0,
    }));
    if (seen(report) || report.state !== "running") return report;
  }
}

/** One analysis at a time, for one panel. */
export class BackgroundJob {
  /** `session`: the open net. `status`: where the progress is shown. `cancelId`: id of the button that cancels. */
  constructor(session, status, cancelId) {
    this.session = session;
    this.status = status;
    this.cancelId = cancelId;
    this.job = null;
  }

  get running() {
    return this.job !== null;
  }

  /**
   * Run an analysis to its end.
   * `body`: the request. `most`: the number of states at which the progress bar is full; 0: unknown. `started(answer)`
   * is called once it runs, `found(result)` whenever more of the answer arrives. Resolves to its last report, with
   * `key`; to null if another panel or net is shown now. Throws the server's error if it does not start.
   */
  async run(body, { most = 0, started = () => {}, found = () => {} }) {
    const job = (this.job = { key: null, unwanted: false });
    this.most = most;
    this.showProgress({ seconds: 0, progress: {} });
    try {
      const answer = await post("analysis", body, { id: this.session.id });
      job.key = answer.job;
      started(answer);
      if (job.unwanted) attempt(() => this.cancel(job));
    } catch (error) {
      if (this.job === job) {
        this.job = null;
        this.status.replaceChildren();
      }
      throw error;
    }
    return this.follow(job, found);
  }

  /** Cancel a job, even before the server has returned its key. */
  cancel(job) {
    job.unwanted = true;
    return job.key && post(`analysis/${job.key}/cancel`);
  }

  async follow(job, found) {
    const left = () => this.job !== job;
    const report = await followJob(job.key, (known) => {
      if (left()) return true;
      if (known.result) found(known.result);
      if (known.state === "running") this.showProgress(known);
      return false;
    });
    if (left()) return null;
    this.job = null;
    this.showEnd(report);
    return { ...report, key: job.key };
  }

  showEnd(report) {
    const words = {
      done: `Done in ${seconds(report.seconds)}.`,
      cancelled: `Cancelled after ${seconds(report.seconds)}.`,
      failed: report.error,
    };
    this.status.replaceChildren(
      h(
        "p",
        { class: report.state === "done" ? "muted" : "", "data-state": report.state },
        report.state === "failed" && h("span.badge.bad", "no answer"),
        ` ${words[report.state]}`,
      ),
    );
  }

  showProgress(report) {
    const { what, count } = report.progress || {};
    const bar = h(
      "progress",
      what === "states" && count < this.most
        ? { max: this.most, value: count, "aria-label": "Progress" }
        : { "aria-label": "Progress" },
    );
    const text = `${seconds(report.seconds)}${what ? ` · ${count.toLocaleString("en")} ${what}` : ""}`;
    if (this.cancelButton && this.status.contains(this.cancelButton)) {
      this.status.firstChild.replaceWith(bar);
      this.progressText.textContent = text;
      return;
    }
    this.progressText = h("span.muted", text);
    this.cancelButton = h("button", {
      id: this.cancelId,
      text: "Cancel",
      onclick: () => this.job && attempt(() => this.cancel(this.job)),
    });
    this.status.replaceChildren(bar, h("div.buttons", this.cancelButton, this.progressText));
  }

  close() {
    if (this.job) Promise.resolve(this.cancel(this.job)).catch(() => {});
    this.job = null;
  }
}
