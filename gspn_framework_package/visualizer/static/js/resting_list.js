// The base of the lists that show what changes often.

import { isPressed } from "./dom.js";

const SHARE = 25; // a list rests for so many times as long as drawing it took

/** A list that is drawn now and then. A subclass has `draw()`. */
export class RestingList extends EventTarget {
  /** `pause`: ms for which it rests at least. */
  constructor(list, pause) {
    super();
    this.list = list;
    this.pause = pause;
    this.timer = 0;
    this.cost = 0; // ms that the last drawing took
  }

  /** Something has changed: draw it, but only a few times a second and with a small share of the time. */
  later() {
    if (!this.timer)
      this.timer = setTimeout(() => this.update(), Math.max(this.pause, SHARE * this.cost));
  }

  /** Draw it now; while the pointer is pressed on a row, which would miss its click, later. */
  update() {
    clearTimeout(this.timer);
    this.timer = 0;
    if (isPressed(this.list)) {
      this.later();
      return;
    }
    const begun = performance.now();
    this.draw();
    this.cost = performance.now() - begun;
  }

  close() {
    clearTimeout(this.timer);
    this.timer = -1; // nothing is drawn any more
  }
}
