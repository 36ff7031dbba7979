// The visible part of the net and its zoom: fitting, zooming, flying to a node.

import { Minimap } from "./minimap.js";

const MARGIN = [52, 56, 42, 30]; // px left, right, above and below a fitted net
const CULL = 800; // in nets with more nodes, only those in view are drawn
const FAR = 0.14; // below this zoom, tokens are too small to distinguish: a marked place is filled
const SMALL = 0.35; // below this zoom, a firing is a flash: moving tokens would be hard to see
const [NEAREST, FARTHEST] = [4, 0.005];
const LARGEST_FIT = [1.6, 2.6]; // largest zoom of a fitted net, on a typical and on a very large screen
const FLIGHT = 260; // ms
const READABLE = 0.55; // from this zoom on, names are readable
const EDGE = 24; // px from the edge within which a node counts as out of sight
const INSIDE = 90; // a node that was out of sight is brought this far from the edge (px)
const THIN = 0.5; // below this zoom, lines are drawn thicker so that they stay visible
const REST = 150; // ms without a move after which the view is at rest
const AROUND = 200; // px around the view that are drawn, too, in large nets: this far it moves without being redrawn
const BLURRED = 3; // the drawing of a large net is stretched up to this factor until it is redrawn

const limited = (k) => Math.min(NEAREST, Math.max(FARTHEST, k));

export class Camera {
  /** `view`: the net view. Its `moving` layers have the transform at which they were last drawn; the sheets that
   * contain them have the difference to the present one. A large net takes long to draw, so only the sheets move until
   * the view rests. */
  constructor(view) {
    this.view = view;
    this.dirty = false; // whether the transform has changed since it was drawn
    this.fitted = false;
    this.small = false;
    this.now = null; // {k, x, y}: zoom, and where the origin of the net is in the container (px)
    this.drawn = null; // the `now` at which the layers were last drawn
    this.around = undefined; // px around the container in which they are drawn
    this.minimap = new Minimap(this);
    this.observer = new ResizeObserver(() => this.resized());
    this.observer.observe(view.container);
  }

  get size() {
    return this.view.container.getBoundingClientRect();
  }

  /** Fit the whole net into the view, clear of the buttons and of the text in the corner. */
  fit() {
    const { width, height } = this.size;
    if (!width || !height) return;
    const [x0, y0, x1, y1] = this.view.bounds();
    const [left, right, top, bottom] = MARGIN;
    const w = Math.max(50, width - left - right),
      h = Math.max(50, height - top - bottom);
    const k = Math.min(
      w / (x1 - x0),
      h / (y1 - y0),
      Math.min(LARGEST_FIT[1], Math.max(LARGEST_FIT[0], width / 900)),
    );
    this.fitted = true;
    this.set(k, left + w / 2 - (k * (x0 + x1)) / 2, top + h / 2 - (k * (y0 + y1)) / 2);
  }

  set(k, x, y) {
    this.now = { k: limited(k), x, y };
    this.dirty = true;
    this.view.request();
  }

  /** Move the view by some pixels. */
  pan(dx, dy) {
    const { k, x, y } = this.now;
    this.stop();
    this.fitted = false;
    this.set(k, x + dx, y + dy);
  }

  /** Zoom around a point of the container, its centre by default. */
  zoom(factor, cx, cy) {
    const { width, height } = this.size;
    const [px, py] = [cx ?? width / 2, cy ?? height / 2];
    const { k, x, y } = this.now;
    const next = limited(k * factor);
    this.stop();
    this.fitted = false;
    this.set(next, px - ((px - x) * next) / k, py - ((py - y) * next) / k);
  }

  /** Bring a node into sight, moving the view no more than needed. If tokens are too small to distinguish, zoom in
   * until names are readable. */
  flyTo(node) {
    const { width, height } = this.size;
    const from = { ...this.now };
    const [sx, sy] = [node.x * from.k + from.x, node.y * from.k + from.y];
    const inSight = sx > EDGE && sy > EDGE && sx < width - EDGE && sy < height - EDGE;
    const near = from.k >= SMALL;
    if (inSight && near) return;
    const k = near ? from.k : READABLE;
    const into = (at, size) => Math.max(Math.min(at, size - INSIDE), Math.min(INSIDE, size / 2));
    const to = near
      ? { k, x: from.x + into(sx, width) - sx, y: from.y + into(sy, height) - sy }
      : { k, x: width / 2 - k * node.x, y: height / 2 - k * node.y };
    this.fitted = false;
    if (matchMedia("(prefers-reduced-motion: reduce)").matches) {
      this.set(to.k, to.x, to.y);
      return;
    }
    const begin = performance.now();
    const flight = (this.flight = {});
    const tick = (now) => {
      if (this.flight !== flight) return;
      const f = Math.min(1, Math.max(0, now - begin) / FLIGHT),
        e = 1 - (1 - f) ** 3;
      this.set(
        from.k + (to.k - from.k) * e,
        from.x + (to.x - from.x) * e,
        from.y + (to.y - from.y) * e,
      );
      if (f < 1) requestAnimationFrame(tick);
      else this.flight = null;
    };
    requestAnimationFrame(tick);
  }

  /** Stop a flight at its current position. */
  stop() {
    this.flight = null;
  }

  resized() {
    const { width, height } = this.size;
    if (!width || !height) return;
    if (!this.now || this.fitted) this.fit();
    this.cull(true);
  }

  draw() {
    this.dirty = false;
    this.small = this.now.k < SMALL;
    this.cull();
    this.minimap.draw();
    this.keepMoving();
    if (this.view.nodes.length < CULL || !this.drawn || !this.move()) this.rest();
    else
      this.resting = setTimeout(() => {
        // unless the next frame, however late it is, moves the view again
        this.last = requestAnimationFrame(() => this.dirty || this.rest());
      }, REST);
  }

  keepMoving() {
    clearTimeout(this.resting);
    cancelAnimationFrame(this.last);
  }

  /** Move and stretch what is drawn. Returns whether it fills the view and is sharp enough. */
  move() {
    const { now, drawn, around } = this;
    const { width, height } = this.size;
    const stretch = now.k / drawn.k;
    const [dx, dy] = [now.x - stretch * drawn.x, now.y - stretch * drawn.y];
    for (const sheet of this.view.container.children)
      sheet.style.transform = `translate(${dx}px, ${dy}px) scale(${stretch})`;
    const fills = (shift, size) =>
      shift <= stretch * around && shift + stretch * (size + around) >= size;
    return stretch < BLURRED && fills(dx, width) && fills(dy, height);
  }

  /** The part of a zoom that takes longer than a frame in a large net: draw what is visible at this
  zoom, lines and arrowheads so thick,
   * and so large, that they are, and hide the nodes that are not in view. */
  rest() {
    const { k, x, y } = (this.drawn = this.now);
    const around = this.view.nodes.length < CULL ? 0 : AROUND;
    if (around !== this.around) this.view.container.style.setProperty("--around", `${around}px`);
    this.around = around;
    // inherited by every element below; changed in steps, so that not every zoom step restyles all of them
    const bold = 2 ** (Math.round(2 * Math.log2(Math.max(1, THIN / k))) / 2);
    if (bold !== this.bold) this.view.container.style.setProperty("--bold", bold.toFixed(2));
    this.bold = bold;
    this.view.container.classList.toggle("far", k < FAR);
    const at = [x, y].map((value) => (value + around).toFixed(1)).join(" ");
    const transform = `translate(${at}) scale(${k.toFixed(4)})`;
    for (const layer of this.view.moving) layer.setAttribute("transform", transform);
    this.view.arcs.zoomed(k);
    // what follows measures the page, which computes all of the styles above
    this.move();
    this.cull(true);
    this.minimap.rest();
  }

  /** Show the nodes that are in view or close to it; `hide`: and no others. */
  cull(hide = false) {
    const { nodes } = this.view;
    if (nodes.length < CULL || !this.now) return;
    const { width, height } = this.size;
    const { k, x, y } = this.now;
    const [x0, y0, x1, y1] = [
      (-x - AROUND) / k,
      (-y - AROUND) / k,
      (width - x + AROUND) / k,
      (height - y + AROUND) / k,
    ];
    for (const node of nodes) {
      const out = node.x < x0 || node.x > x1 || node.y < y0 || node.y > y1;
      node.out = out;
      if (out === Boolean(node.hidden) || (out && !hide)) continue;
      node.hidden = out;
      node.element.style.display = out ? "none" : "";
    }
  }

  close() {
    this.stop();
    this.keepMoving();
    this.observer.disconnect();
    this.minimap.element.remove();
  }
}
