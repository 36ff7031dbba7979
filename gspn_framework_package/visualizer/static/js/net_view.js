// The net as SVG: three layers (arcs, nodes, travelling tokens) under one transform.
// All arcs of a kind are one path; changes are gathered and drawn once per frame.

import { h, s } from "./dom.js";
import { RADIUS, BAR, arcShape, arcPaths, dots, discs } from "./geometry.js";
import { colourOf, shortName } from "./colours.js";
import { Travel } from "./travel.js";
import { Labels } from "./labels.js";

const MARGIN = [52, 56, 42, 30]; // px left, right, above and below a net that is fitted
const CULL = 800; // nets with more nodes draw only what is in the view
const FAR = 0.14; // below this zoom tokens are too small to be told apart: a place with any is filled
const SMALL = 0.35; // below this zoom a firing is a flash: what travels could hardly be seen
const TILE = 40; // nodes that are drawn together in a large net
const MANY = 2000; // nets with more nodes are drawn every other frame

// one path for all tokens of a place
const DOTS = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9].map((count) => dots(count).map(([x, y]) => {
  const r = count === 1 ? 5 : 3.4;
  return `M${(x - r).toFixed(2)} ${y.toFixed(2)}a${r} ${r} 0 1 0 ${2 * r} 0a${r} ${r} 0 1 0 ${-2 * r} 0z`;
}).join(""));

/** Fires "select" (detail {kind, index}), "activate" (double click) and "frame" (detail.n, after drawing). */
export class NetView extends EventTarget {
  constructor(container, model) {
    super();
    this.container = container;
    this.model = model;
    this.scene = model.scene;
    this.dirty = { places: new Set(), transitions: new Set() };
    this.pending = new Map(); // place -> tokens that are still on their way there
    this.pendingRobots = new Map();
    this.selection = null;
    this.showEnabled = true;
    this.build();
    this.travel = new Travel(this);
    this.labels = new Labels(this);
    this.events();
    this.observer = new ResizeObserver(() => this.resized());
    this.observer.observe(container);
  }

  // -- building ------------------------------------------------------------------------------------

  build() {
    const { scene } = this;
    this.key = `gspn-layout-${scene.hash}`;
    this.nodes = [];
    this.place(scene.layout);
    this.layer = { arcs: s("g"), travel: s("g") };
    const sheet = (name, ...content) => s("svg", { class: name, "aria-hidden": "true" }, ...content);
    this.tiles = new Map();
    for (const node of this.nodes) {
      node.element = node.kind === "place" ? this.buildPlace(node) : this.buildTransition(node);
      this.tileOf(node).append(node.element);
    }
    const says = `The net: ${scene.places.length} places, ${scene.transitions.length} transitions. Use the list to go through it.`;
    const nodes = h("div", { class: "nodes", role: "img", "aria-label": says }, [...this.tiles.values()].map((tile) => sheet("tile", tile)));
    this.path = {};
    for (const name of ["lines", "inhibitor", "near", "heads", "circles"]) {
      this.path[name] = s("path", { class: { inhibitor: "lines inhibitor", near: "lines near" }[name] || name });
      this.layer.arcs.append(this.path[name]);
    }
    this.weights = s("g");
    this.layer.arcs.append(this.weights);
    this.container.replaceChildren(sheet("arcs", this.layer.arcs), nodes, sheet("travel", this.layer.travel));
    this.moving = [...Object.values(this.layer), ...this.tiles.values()];
    this.routeArcs();
  }

  place(layout) {
    const { scene } = this;
    const moved = this.movedPositions();
    this.routes = layout.routes;
    this.atHome = [];
    const make = (kind, index, [x, y], name) => {
      const at = moved[name];
      const node = this.nodes[index + (kind === "place" ? 0 : scene.places.length)] || { kind, index, name };
      node.x = at ? at[0] : x;
      node.y = at ? at[1] : y;
      node.moved = Boolean(at);
      return node;
    };
    const places = scene.places.map((p, i) => make("place", i, layout.places[i], p.name));
    const transitions = scene.transitions.map((t, i) => make(t.timed ? "timed" : "immediate", i, layout.transitions[i], t.name));
    this.nodes = [...places, ...transitions];
    this.places = places;
    this.transitions = transitions;
  }

  /** The group that a node is drawn in, with the nodes around it: what does not change is not drawn again. */
  tileOf(node) {
    const many = this.nodes.length > CULL;
    if (many && !this.tileSize) {
      const [x0, y0, x1, y1] = this.bounds();
      this.tileSize = Math.sqrt(((x1 - x0) * (y1 - y0) * TILE) / this.nodes.length);
    }
    const key = many ? `${Math.floor(node.x / this.tileSize)},${Math.floor(node.y / this.tileSize)}` : "";
    if (!this.tiles.has(key)) this.tiles.set(key, s("g"));
    return this.tiles.get(key);
  }

  movedPositions() {
    try {
      return JSON.parse(localStorage.getItem(this.key)) || {};
    } catch (error) {
      return {};
    }
  }

  keepPositions() {
    const moved = {};
    for (const node of this.nodes) if (node.moved) moved[node.name] = [Math.round(node.x), Math.round(node.y)];
    try {
      if (Object.keys(moved).length) localStorage.setItem(this.key, JSON.stringify(moved));
      else localStorage.removeItem(this.key);
    } catch (error) { /* private browsing: kept until the page is closed */ }
  }

  buildPlace(node) {
    const place = this.scene.places[node.index];
    return s("g", { class: `place ${place.kind}`, transform: `translate(${node.x} ${node.y})`, "data-place": node.index },
      s("title", { text: place.name }),
      s("circle", { r: RADIUS }));
  }

  buildTransition(node) {
    const transition = this.scene.transitions[node.index];
    const [w, h] = BAR[node.kind];
    return s("g", { class: `transition ${node.kind}`, transform: `translate(${node.x} ${node.y})`, "data-transition": node.index },
      s("title", { text: transition.name }),
      node.kind === "immediate" && s("rect", { class: "hit", x: -12, y: -h, width: 24, height: 2 * h }),
      s("rect", { class: "body", x: -w, y: -h, width: 2 * w, height: 2 * h, rx: 1 }));
  }

  /** Compute where all arcs run, or those of one node. */
  routeArcs(only = null) {
    const { scene } = this;
    if (!this.arcs) {
      const seen = new Set(scene.arcs.map(([p, t, forth]) => `${p},${t},${forth}`));
      this.arcs = scene.arcs.map(([p, t, forth, weight, inhibitor], index) => {
        const from = forth ? this.places[p] : this.transitions[t];
        const to = forth ? this.transitions[t] : this.places[p];
        return { index, from, to, weight, inhibitor, both: seen.has(`${p},${t},${1 - forth}`) };
      });
    }
    for (const arc of this.arcs) {
      if (only && arc.from !== only && arc.to !== only) continue;
      const home = !arc.from.moved && !arc.to.moved;
      const shape = arcShape(arc.from, arc.to, home ? this.routes[arc.index] : null, arc.both ? 16 : 0);
      Object.assign(arc, arcPaths(shape, arc.inhibitor), { middle: shape.middle, points: shape.points });
    }
    const join = (pick) => this.arcs.map(pick).filter(Boolean).join("");
    this.path.lines.setAttribute("d", join((a) => !a.inhibitor && a.line));
    this.path.inhibitor.setAttribute("d", join((a) => a.inhibitor && a.line));
    this.path.heads.setAttribute("d", join((a) => a.head));
    this.path.circles.setAttribute("d", join((a) => a.circle));
    this.weights.replaceChildren(...this.arcs.filter((a) => a.weight > 1).map((a) =>
      s("text", { x: a.middle[0], y: a.middle[1], text: String(a.weight) })));
    this.drawNear();
  }

  drawNear() {
    const node = this.selection && this.nodeOf(this.selection);
    const near = node ? this.arcs.filter((a) => (a.from === node || a.to === node) && !a.inhibitor) : [];
    this.path.near.setAttribute("d", near.map((a) => a.line).join(""));
  }

  // -- view ----------------------------------------------------------------------------------------

  bounds() {
    let [x0, y0, x1, y1] = [Infinity, Infinity, -Infinity, -Infinity];
    for (const { x, y } of this.nodes) {
      x0 = Math.min(x0, x); y0 = Math.min(y0, y); x1 = Math.max(x1, x); y1 = Math.max(y1, y);
    }
    return this.nodes.length ? [x0 - 24, y0 - 32, x1 + 24, y1 + 24] : [0, 0, 100, 100];
  }

  /** The whole net, clear of the buttons and of the words in the corner. */
  fit() {
    const { width, height } = this.container.getBoundingClientRect();
    if (!width || !height) return;
    const [x0, y0, x1, y1] = this.bounds();
    const [left, right, top, bottom] = MARGIN;
    const w = Math.max(50, width - left - right), h = Math.max(50, height - top - bottom);
    const k = Math.min(w / (x1 - x0), h / (y1 - y0), 1.6);
    this.fitted = true;
    this.setView(k, left + w / 2 - (k * (x0 + x1)) / 2, top + h / 2 - (k * (y0 + y1)) / 2);
  }

  setView(k, x, y) {
    const limited = Math.min(4, Math.max(0.02, k));
    this.view = { k: limited, x, y };
    if (!this.viewDirty) {
      this.viewDirty = true;
      this.request();
    }
  }

  zoom(factor, cx, cy) {
    const box = this.container.getBoundingClientRect();
    const [px, py] = [cx ?? box.width / 2, cy ?? box.height / 2];
    const { k, x, y } = this.view;
    const next = Math.min(4, Math.max(0.02, k * factor));
    this.fitted = false;
    this.setView(next, px - ((px - x) * next) / k, py - ((py - y) * next) / k);
  }

  flyTo(kind, index) {
    const node = this.nodeOf({ kind, index });
    const { width, height } = this.container.getBoundingClientRect();
    const from = { ...this.view };
    const k = Math.max(this.view.k, 0.9);
    const to = { k, x: width / 2 - k * node.x, y: height / 2 - k * node.y };
    this.fitted = false;
    if (matchMedia("(prefers-reduced-motion: reduce)").matches) { this.setView(to.k, to.x, to.y); return; }
    const begin = performance.now();
    const flight = (this.flight = {});
    const tick = (now) => {
      if (this.flight !== flight) return;
      const f = Math.min(1, (now - begin) / 260), e = 1 - (1 - f) ** 3;
      this.setView(from.k + (to.k - from.k) * e, from.x + (to.x - from.x) * e, from.y + (to.y - from.y) * e);
      if (f < 1) requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  resized() {
    const { width, height } = this.container.getBoundingClientRect();
    if (!width || !height) return;
    if (!this.view || this.fitted) this.fit();
    this.cull();
  }

  drawView() {
    this.viewDirty = false;
    const { k, x, y } = this.view;
    const transform = `translate(${x.toFixed(1)} ${y.toFixed(1)}) scale(${k.toFixed(4)})`;
    for (const layer of this.moving) layer.setAttribute("transform", transform);
    this.small = k < SMALL;
    const far = k < FAR;
    if (far !== this.far) {
      this.far = far;
      this.container.classList.toggle("far", far);
    }
    this.cull();
    this.labels.later();
  }

  /** Leave out the nodes that are not in the view. */
  cull() {
    if (this.nodes.length < CULL || !this.view) return;
    const { width, height } = this.container.getBoundingClientRect();
    const { k, x, y } = this.view;
    const [x0, y0, x1, y1] = [(-x - 80) / k, (-y - 60) / k, (width - x + 80) / k, (height - y + 60) / k];
    for (const node of this.nodes) {
      const out = node.x < x0 || node.x > x1 || node.y < y0 || node.y > y1;
      if (out !== Boolean(node.out)) {
        node.out = out;
        node.element.style.display = out ? "none" : "";
      }
    }
  }

  // -- the board -----------------------------------------------------------------------------------

  reset() {
    this.travel.clear();
    this.pending.clear();
    this.pendingRobots.clear();
    for (let p = 0; p < this.places.length; p++) this.dirty.places.add(p);
    for (let t = 0; t < this.transitions.length; t++) this.dirty.transitions.add(t);
    this.request();
  }

  /** Events were added to the board. */
  show(events) {
    for (const event of events) {
      if (event.k === "fire" || event.k === "undo") {
        for (const [p] of event.d) this.dirty.places.add(p);
        for (const t of event.en) this.dirty.transitions.add(t);
        for (const t of event.dis) this.dirty.transitions.add(t);
        for (const [, from, to] of event.m) {
          if (from !== null) this.dirty.places.add(from);
          if (to !== null) this.dirty.places.add(to);
        }
        if (event.k === "fire") this.travel.fired(event);
      } else if (event.k === "mark") {
        this.reset();
      } else if (event.k === "robots") {
        for (let p = 0; p < this.places.length; p++) if (this.places[p].robots) this.dirty.places.add(p);
        for (const robot of event.r) if (robot.place >= 0) this.dirty.places.add(robot.place);
      }
    }
    this.request();
  }

  request() {
    if (this.frame) return;
    this.frame = requestAnimationFrame(() => this.draw());
  }

  /** Whether this frame is left out: only the view of a large net that stands still. */
  skips() {
    this.odd = !this.odd;
    return this.odd && this.nodes.length > MANY && !this.viewDirty && !this.gesture;
  }

  draw() {
    this.frame = 0;
    if (this.skips()) { this.request(); return; }
    const { board } = this.model;
    if (this.viewDirty) this.drawView();
    if (!board) return;
    if (this.dirty.places.size) {
      const robots = new Map();
      for (const robot of board.robots.values()) {
        if (robot.place === undefined || robot.place < 0 || robot.phase === "lost" || robot.phase === "left") continue;
        if (this.pendingRobots.has(robot.name)) continue;
        if (!robots.has(robot.place)) robots.set(robot.place, []);
        robots.get(robot.place).push(robot);
      }
      for (const p of this.dirty.places) this.drawPlace(p, board.marking[p] - (this.pending.get(p) || 0), robots.get(p) || []);
      this.dirty.places.clear();
    }
    for (const t of this.dirty.transitions) this.drawTransition(t, board.enabled.has(t));
    this.dirty.transitions.clear();
    this.travel.begin();
    this.dispatchEvent(new CustomEvent("frame", { detail: { n: board.n } }));
  }

  drawPlace(p, tokens, robots) {
    const node = this.places[p];
    const count = Math.max(0, tokens);
    if (robots.length && robots.length >= count && robots.length <= 9) {
      this.drawDots(node, 0, true);
      this.drawRobots(node, robots);
    } else {
      if (node.robots) this.drawRobots(node, []);
      this.drawDots(node, count);
    }
  }

  drawDots(node, count, robotsHere = false) {
    if (node.count === count) return;
    if ((node.count > 0) !== (count > 0)) node.element.classList.toggle("marked", count > 0 || robotsHere);
    node.count = count;
    if (node.dots) { node.dots.remove(); node.dots = null; }
    if (count === 0) return;
    node.dots = count <= 9
      ? s("path", { class: "dots", d: DOTS[count], "data-count": count })
      : s("text", { class: "count", text: count < 100000 ? String(count) : "99999+" });
    if (count > 999) node.dots.style.fontSize = count > 9999 ? "10px" : "12px";
    node.element.append(node.dots);
  }

  drawRobots(node, robots) {
    if (node.robots) { node.robots.remove(); node.robots = null; }
    if (!robots.length) return;
    const { radius, centres } = discs(robots.length);
    node.robots = s("g", {}, robots.sort((a, b) => (a.name < b.name ? -1 : 1)).map((robot, i) => {
      const phase = robot.why && robot.phase !== "failed" ? "waiting" : robot.phase || "";
      const id = shortName(robot.name);
      const text = s("text", { text: id });
      text.style.fontSize = `${Math.min(radius * 1.15, (radius * 2.6) / Math.max(1, id.length)).toFixed(1)}px`;
      const disc = s("circle", { r: radius });
      disc.style.fill = colourOf(robot.name);
      return s("g", { class: `robot ${phase}${robot.paused ? " paused" : ""}`, transform: `translate(${centres[i][0].toFixed(1)} ${centres[i][1].toFixed(1)})`, "data-robot": robot.name },
        s("title", { text: robot.name }), disc, text);
    }));
    node.element.append(node.robots);
  }

  drawTransition(t, enabled) {
    const node = this.transitions[t];
    if (node.enabled === enabled) return;
    node.enabled = enabled;
    node.element.classList.toggle("enabled", enabled);
    if (enabled && !node.flag) {
      node.flag = s("path", { class: "flag", d: `M-6 ${-BAR[node.kind][1] - 11}h12l-6 7z` });
      node.element.append(node.flag);
    }
  }

  flash(t) {
    const { element } = this.transitions[t];
    element.classList.add("flash");
    clearTimeout(element.flashTimer);
    element.flashTimer = setTimeout(() => element.classList.remove("flash"), 160);
  }

  setShowEnabled(on) {
    this.showEnabled = on;
    this.container.classList.toggle("no-enabled", !on);
  }

  // -- painting of results -------------------------------------------------------------------------

  /** `paint`: {places: {index: {kind, value}}, transitions: {...}}; null takes all paint away.
   * kind: bad, good, mark, or heat with a level from 0 to 1. */
  paint(paint) {
    for (const node of this.nodes) {
      const wanted = paint && (node.kind === "place" ? paint.places : paint.transitions)?.[node.index];
      node.element.classList.remove("paint-bad", "paint-good", "paint-mark");
      const body = node.element.querySelector(node.kind === "place" ? "circle" : "rect.body");
      body.style.fill = "";
      if (node.value) { node.value.remove(); node.value = null; }
      if (!wanted) continue;
      if (wanted.kind === "heat") {
        body.style.fill = `color-mix(in srgb, var(--accent) ${Math.round(8 + 62 * wanted.level)}%, var(--sheet))`;
      } else {
        node.element.classList.add(`paint-${wanted.kind}`);
      }
      if (wanted.text) {
        node.value = s("text", { class: "value", y: -(node.kind === "place" ? RADIUS : BAR[node.kind][1]) - 6, text: wanted.text });
        node.element.append(node.value);
      }
    }
  }

  // -- selecting, dragging -------------------------------------------------------------------------

  nodeOf({ kind, index }) {
    return kind === "place" ? this.places[index] : this.transitions[index];
  }

  select(selection) {
    if (this.selection) this.nodeOf(this.selection).element.classList.remove("selected");
    this.selection = selection;
    if (selection) this.nodeOf(selection).element.classList.add("selected");
    this.labels.later();
    this.drawNear();
  }

  hit(target) {
    const element = target.closest("[data-place], [data-transition]");
    if (!element) return null;
    const { place, transition } = element.dataset;
    return place !== undefined ? { kind: "place", index: Number(place) } : { kind: "transition", index: Number(transition) };
  }

  events() {
    const { container } = this;
    const point = (event) => {
      const box = container.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    container.onwheel = (event) => {
      event.preventDefault();
      this.flight = null;
      this.zoom(Math.exp(-Math.max(-60, Math.min(60, event.deltaY * (event.deltaMode ? 20 : 1))) / 220), ...point(event));
    };
    container.onpointerdown = (event) => {
      if (event.button !== 0 && event.button !== 1) return;
      this.flight = null;
      const hit = event.button === 0 ? this.hit(event.target) : null;
      this.gesture = { hit, node: hit && this.nodeOf(hit), at: point(event), view: { ...this.view }, moved: false };
      container.setPointerCapture(event.pointerId);
    };
    container.onpointermove = (event) => {
      const { gesture } = this;
      if (!gesture) return;
      const [x, y] = point(event);
      const [dx, dy] = [x - gesture.at[0], y - gesture.at[1]];
      if (!gesture.moved && Math.hypot(dx, dy) < 4) return;
      if (!gesture.moved) {
        gesture.moved = true;
        if (gesture.node) gesture.start = [gesture.node.x, gesture.node.y];
        container.classList.add("dragging");
      }
      if (!gesture.node) {
        this.fitted = false;
        this.setView(gesture.view.k, gesture.view.x + dx, gesture.view.y + dy);
        return;
      }
      const { node } = gesture;
      node.x = gesture.start[0] + dx / this.view.k;
      node.y = gesture.start[1] + dy / this.view.k;
      node.moved = true;
      node.element.setAttribute("transform", `translate(${node.x.toFixed(1)} ${node.y.toFixed(1)})`);
      if (!gesture.routing) {
        gesture.routing = requestAnimationFrame(() => { gesture.routing = 0; this.routeArcs(node); });
      }
    };
    container.onpointerup = container.onpointercancel = (event) => {
      const { gesture } = this;
      this.gesture = null;
      container.classList.remove("dragging");
      if (!gesture) return;
      if (gesture.moved && gesture.node) { this.routeArcs(gesture.node); this.keepPositions(); this.labels.later(); return; }
      if (!gesture.moved && event.type === "pointerup") {
        this.dispatchEvent(new CustomEvent("select", { detail: gesture.hit }));
        const now = performance.now();
        const again = gesture.hit && this.lastClick && now - this.lastClick.at < 400 && this.lastClick.node === gesture.node;
        this.lastClick = { at: now, node: gesture.node };
        if (again) this.dispatchEvent(new CustomEvent("activate", { detail: gesture.hit }));
      }
    };
  }

  /** Another layout from the server; what was dragged goes back. */
  relayout(layout) {
    try { localStorage.removeItem(this.key); } catch (error) { /* nothing was kept */ }
    this.place(layout);
    for (const node of this.nodes) node.element.setAttribute("transform", `translate(${node.x} ${node.y})`);
    this.routeArcs();
    this.fit();
    this.labels.later();
  }

  close() {
    this.observer.disconnect();
    this.labels.close();
    this.travel.clear();
    cancelAnimationFrame(this.frame);
    this.frame = -1;
    this.container.replaceChildren();
  }
}
