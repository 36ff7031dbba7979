// Base class of lists and panels whose content changes often.

import { isPressed } from "./dom.js";

const SHARE = 25; // a list rests for this multiple of the time that drawing it took

/** A list, or a panel, that limits how often it is drawn. A subclass defines `draw()`. */
export class RestingList extends EventTarget {
  /** `pause`: minimum ms between two drawings. */
  constructor(list, pause) {
    super();
    this.list = list;
    this.pause = pause;
    this.timer = 0;
    this.cost = 0; // duration of the last drawing, in ms
  }

  /** Something has changed: draw it, but only a few times a second and for a small share of the time. */
  later() {
    if (!this.timer)
      this.timer = setTimeout(() => this.update(), Math.max(this.pause, SHARE * this.cost));
  }

  /** Draw it now, or later if the pointer is pressed on a row, which would lose its click. */
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

  /** Announce to screen readers which row has the focus, and scroll to it. */
  showRow(row) {
    const { list } = this;
    list.setAttribute("aria-activedescendant", row.id);
    const [top, height] = [row.offsetTop, row.offsetHeight];
    if (top < list.scrollTop || top + height > list.scrollTop + list.clientHeight)
      list.scrollTop = top - list.clientHeight / 2;
  }

  close() {
    clearTimeout(this.timer);
    this.timer = -1; // this view is no longer drawn
  }
}
