// Plays a firing sequence step by step on a stage: the simulation, or the editor's canvas.

import { h, pause } from "./dom.js";

const PAUSE = 700; // ms between two steps while it plays

/** Plays the transitions `steps` (names) on a stage: {begin(), fire(name), back()}, each of which resolves to whether
 * it succeeded. Fires "change". */
export class FiringSequence extends EventTarget {
  constructor(steps, stage) {
    super();
    this.steps = steps;
    this.stage = stage;
    this.at = null; // number of steps fired; null before the start
    this.playing = false;
    this.busy = false;
  }

  get ended() {
    return this.at === this.steps.length;
  }

  /** Fire the next step; begin first if it has not begun. Resolves to whether that succeeded. */
  next() {
    return this.alone(async () => {
      if (this.at === null && !(await this.begin())) return false;
      if (this.ended || !(await this.stage.fire(this.steps[this.at]))) return false;
      this.at += 1;
      return true;
    });
  }

  previous() {
    return this.alone(async () => {
      if (!this.at || !(await this.stage.back())) return false;
      this.at -= 1;
      return true;
    });
  }

  /** Play the remaining steps, or all again. */
  async play() {
    if (this.playing) return;
    this.playing = true;
    if (this.ended) this.at = null;
    while (this.playing && (await this.next()) && !this.ended) await pause(PAUSE);
    this.stop();
  }

  stop() {
    this.playing = false;
    this.emit();
  }

  async begin() {
    if (!(await this.stage.begin())) return false;
    this.at = 0;
    return true;
  }

  /** Run one action at a time: a second press while one is under way does nothing. */
  async alone(action) {
    if (this.busy) return false;
    this.busy = true;
    this.emit();
    try {
      return await action();
    } finally {
      this.busy = false;
      this.emit();
    }
  }

  emit() {
    this.dispatchEvent(new Event("change"));
  }
}

/** The buttons of a sequence: previous step, play, next step; and its position. */
export function sequenceControls(sequence) {
  const button = (label, name, press) =>
    h("button", { text: label, title: name, "aria-label": name, onclick: press });
  const previous = button("◂", "Previous step", () => sequence.previous());
  const play = button("▶ Play", "Play the sequence from its start", () =>
    sequence.playing ? sequence.stop() : sequence.play(),
  );
  const next = button("▸", "Next step", () => sequence.next());
  const where = h("span.muted", { role: "status" });
  const show = () => {
    const { at, steps, playing, busy, ended } = sequence;
    if (playing && !where.isConnected) sequence.playing = false; // another answer has replaced it
    previous.disabled = busy || playing || !at;
    next.disabled = busy || playing || ended;
    play.textContent = playing ? "❚❚ Stop" : "▶ Play";
    where.textContent = ended
      ? `${steps.length} of ${steps.length} fired`
      : `${at || 0} of ${steps.length} fired, next ${steps[at || 0]}`;
  };
  sequence.addEventListener("change", show);
  show();
  return h("div.buttons.sequence", previous, play, next, where);
}
