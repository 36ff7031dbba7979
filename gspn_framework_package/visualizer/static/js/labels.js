// Names beside the nodes: of readable size at every zoom, and only those that overlap nothing.

import { s } from "./dom.js";
import { RADIUS, BAR } from "./geometry.js";

const CHARACTERS = 24;
const FONT = 11;
const WIDTH = 6.3; // mean width of a character at that size
const SMALLEST = 0.28; // below this zoom no names
const DRAWN = 700; // at most
const CELL = 64;
const ARCS = 1500; // names keep clear of arcs in nets with up to this many

const shorten = (name) => {
  const characters = [...name];
  return characters.length > CHARACTERS ? `${characters.slice(0, CHARACTERS - 1).join("")}…` : name;
};

export class Labels {
  constructor(view) {
    this.view = view;
    for (const node of view.nodes) node.text = shorten(node.name);
  }

  later() {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.place(), this.drawn ? 110 : 0);
  }

  /** Boxes in pixels; a coarse grid tells which are near. */
  place() {
    const { view } = this;
    if (!view.camera.now || !view.nodes.length) return;
    const { k, x, y } = view.camera.now;
    const { left, top, width, height } = view.container.getBoundingClientRect();
    this.drawn = true;
    const grid = new Map(), lines = new Map();
    const cells = ([x0, y0, x1, y1]) => {
      const keys = [];
      for (let i = Math.floor(x0 / CELL); i <= Math.floor(x1 / CELL); i++) {
        for (let j = Math.floor(y0 / CELL); j <= Math.floor(y1 / CELL); j++) keys.push(i * 100003 + j);
      }
      return keys;
    };
    const put = (box) => { for (const key of cells(box)) { if (!grid.has(key)) grid.set(key, []); grid.get(key).push(box); } };
    const free = (box) => box[0] > 2 && box[1] > 2 && box[2] < width - 2 && box[3] < height - 2 && cells(box).every((key) => (grid.get(key) || []).every((b) => b[0] >= box[2] || b[2] <= box[0] || b[1] >= box[3] || b[3] <= box[1]));
    const clear = (box) => cells(box).every((key) => (lines.get(key) || []).every(([px, py]) => px <= box[0] - 1 || px >= box[2] + 1 || py <= box[1] + 1 || py >= box[3] - 2));
    const seen = [];
    for (const node of view.nodes) {
      const [sx, sy] = [node.x * k + x, node.y * k + y];
      const inside = sx > -60 && sy > -40 && sx < width + 60 && sy < height + 40;
      if (inside) seen.push([node, sx, sy]);
      else this.take(node, null);
    }
    const size = Math.max(k, 1) * FONT * Math.min(1, 1.06 - 0.06 / Math.max(k, 0.2)); // on the screen
    const shown = Math.max(9.5, size);
    view.container.style.setProperty("--label", `${(shown / k).toFixed(2)}px`);
    if (k < SMALLEST) {
      for (const [node] of seen) this.take(node, null);
      return;
    }
    for (const [node, sx, sy] of seen) {
      const [w, h] = node.kind === "place" ? [RADIUS, RADIUS] : BAR[node.kind];
      const flag = node.kind === "place" ? 0 : 11;
      put([sx - w * k, sy - (h + flag) * k, sx + w * k, sy + h * k]);
    }
    if (view.arcs.all.length <= ARCS) this.sampleArcs(lines, view.camera.now);
    for (const element of view.container.parentElement.querySelectorAll(".zoom, .frame-name")) {
      const box = element.getBoundingClientRect();
      put([box.left - left, box.top - top, box.right - left, box.bottom - top]);
    }
    const line = shown * 1.25, unit = (shown / FONT) * WIDTH;
    for (const [node, sx, sy] of seen) {
      if (!node.value) continue;
      const [half, top] = [(node.value.textContent.length * unit) / 2, sy + Number(node.value.getAttribute("y")) * k];
      put([sx - half, top - line * 0.85, sx + half, top + line * 0.15]);
    }
    const chosen = view.selection && view.nodeOf(view.selection);
    seen.sort((a, b) => (b[0] === chosen) - (a[0] === chosen) || (a[0].kind === "place" ? 0 : 1) - (b[0].kind === "place" ? 0 : 1));
    let drawn = 0;
    for (const [node, sx, sy] of seen) {
      const [w, h] = node.kind === "place" ? [RADIUS, RADIUS] : BAR[node.kind];
      const flag = node.kind === "place" ? 0 : 11;
      const length = [...node.text].length * unit * (node === chosen ? 1.12 : 1);
      const gap = 3;
      const spots = [
        [sx - length / 2, sy + h * k + gap, "middle", 0, h + (gap + shown * 0.95) / k],
        [sx - length / 2, sy - (h + flag) * k - gap - line, "middle", 0, -(h + flag) - (gap + shown * 0.3) / k],
        [sx + w * k + gap + 1, sy - line / 2, "start", w + (gap + 1) / k, (shown * 0.35) / k],
        [sx - w * k - gap - 1 - length, sy - line / 2, "end", -w - (gap + 1) / k, (shown * 0.35) / k],
      ];
      const open = drawn < DRAWN ? spots.filter(([bx, by]) => free([bx, by, bx + length, by + line])) : [];
      const spot = open.find(([bx, by]) => clear([bx, by, bx + length, by + line])) || open[0];
      if (!spot) { this.take(node, null); continue; }
      drawn += 1;
      put([spot[0], spot[1], spot[0] + length, spot[1] + line]);
      this.take(node, spot);
    }
  }

  /** Points of the arcs, in pixels, by cell. */
  sampleArcs(lines, { k, x, y }) {
    for (const arc of this.view.arcs.all) {
      for (let i = 1; i < arc.points.length; i++) {
        const [ax, ay] = [arc.points[i - 1][0] * k + x, arc.points[i - 1][1] * k + y];
        const [bx, by] = [arc.points[i][0] * k + x, arc.points[i][1] * k + y];
        const steps = Math.min(200, Math.ceil(Math.hypot(bx - ax, by - ay) / 6));
        for (let j = 0; j <= steps; j++) {
          const px = ax + ((bx - ax) * j) / steps, py = ay + ((by - ay) * j) / steps;
          const key = Math.floor(px / CELL) * 100003 + Math.floor(py / CELL);
          if (!lines.has(key)) lines.set(key, []);
          lines.get(key).push([px, py]);
        }
      }
    }
  }

  take(node, spot) {
    if (!spot) {
      if (node.label) { node.label.remove(); node.label = null; }
      return;
    }
    if (!node.label) {
      node.label = s("text", { class: "label", text: node.text });
      node.element.append(node.label);
    }
    node.label.setAttribute("x", spot[3].toFixed(1));
    node.label.setAttribute("y", spot[4].toFixed(1));
    node.label.style.textAnchor = spot[2];
  }

  close() {
    clearTimeout(this.timer);
  }
}
