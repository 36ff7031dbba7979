// The time line: a lane per robot in its colour (paler while it waits), a lane of firings; scrubber below.

import { $, seconds } from "./dom.js";
import { colourOf } from "./colours.js";

const SPANS = [1, 2, 5, 10, 30, 60, 300, 1200, 7200, 86400];
const TICKS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 1800, 3600, 14400]; // s
const LABEL = 92;

const axisTime = (t) => (t < 60 ? `${Number(t.toFixed(1))} s` : seconds(t));

/** Fires "visit" (detail n). */
export class TimeLine extends EventTarget {
  constructor(model) {
    super();
    this.model = model;
    this.canvas = $("lanes");
    this.span = null; // seconds shown; null: chosen by how much there is
    this.canvas.onclick = (event) => this.clicked(event);
    this.canvas.onwheel = (event) => {
      event.preventDefault();
      const at = SPANS.indexOf(this.shownSpan || 30);
      this.span = SPANS[Math.max(0, Math.min(SPANS.length - 1, at + (event.deltaY > 0 ? 1 : -1)))];
      this.update();
    };
    this.observer = new ResizeObserver(() => this.update());
    this.observer.observe(this.canvas);
    this.clock = setInterval(() => { if (model.mode === "LIVE" && model.following && model.lostAt === null && model.board?.status.running) this.later(); }, 200);
  }

  later() {
    if (!this.timer) this.timer = setTimeout(() => { this.timer = 0; requestAnimationFrame(() => this.update()); }, Math.max(90, 25 * (this.cost || 0)));
  }

  /** What each robot did in the events at hand: name -> [[from, to, place, phase], ...]. */
  segments(begin, end) {
    const { model } = this;
    const lanes = new Map();
    const lane = (name) => {
      if (!lanes.has(name)) lanes.set(name, { at: begin, place: undefined, phase: "doing", parts: [] });
      return lanes.get(name);
    };
    const cut = (l, t, place, phase) => {
      if (l.place !== undefined && l.place !== null && t > l.at) l.parts.push([l.at, t, l.place, l.phase]);
      l.at = Math.max(begin, t);
      l.place = place;
      l.phase = phase;
    };
    const last = model.indexAfter(model.board.n);
    for (let i = this.firstAt(begin, last); i < last; i++) {
      const event = model.events[i];
      if (event.k === "fire") {
        for (const [name, from, to] of event.m) {
          const l = lane(name);
          if (l.place === undefined) l.place = from;
          cut(l, event.t, to, "doing");
        }
      } else if (event.k === "robots") {
        for (const robot of event.r) {
          const l = lane(robot.name);
          const place = robot.place === undefined ? l.place : robot.place;
          if (l.place === undefined) l.place = place;
          const phase = robot.phase === undefined ? l.phase : robot.phase;
          if (place !== l.place || phase !== l.phase) cut(l, event.t, place, phase);
        }
      }
    }
    for (const robot of model.board.robots.values()) {
      const l = lane(robot.name);
      if (l.place === undefined) { l.place = robot.place; l.phase = robot.phase || "doing"; l.at = Math.max(begin, robot.since ?? begin); }
    }
    for (const l of lanes.values()) cut(l, end, null, "");
    return lanes;
  }

  /** Index of the first event at hand that is not before `t`. */
  firstAt(t, last) {
    const { events } = this.model;
    let low = 0, high = last;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (events[middle].t < t) low = middle + 1; else high = middle;
    }
    return low;
  }

  update() {
    const begun = performance.now();
    const { model, canvas } = this;
    if (!model.board) return;
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth: width, clientHeight: height } = canvas;
    if (!width || !height) return;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const style = getComputedStyle(document.body);
    const ink = (name) => style.getPropertyValue(name).trim();
    const c = canvas.getContext("2d");
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, width, height);
    const end = model.now();
    const have = model.events.length ? end - model.events[0].t : 0;
    this.shownSpan = this.span || SPANS.find((span) => span >= Math.min(have, 60)) || 60;
    const begin = Math.max(0, end - this.shownSpan); // a short run fills the lanes from the left
    const right = width - 14;
    const x = (t) => LABEL + ((t - begin) / this.shownSpan) * (right - LABEL);
    this.scale = { begin, end: begin + this.shownSpan, right };

    const lanes = this.segments(begin, end);
    const names = [...lanes.keys()].sort((a, b) => a.localeCompare(b, undefined, { numeric: true }));
    const top = 8, axis = 20, rows = names.length + 1;
    const room = height - top - axis;
    const step = Math.min(26, room / rows);
    c.font = "11px system-ui, sans-serif";
    c.textBaseline = "middle";

    // the axis
    c.strokeStyle = ink("--line-soft");
    c.fillStyle = ink("--ink-3");
    c.textAlign = "center";
    const tick = TICKS.find((step) => (step / this.shownSpan) * (right - LABEL) >= 70) || this.shownSpan;
    for (let i = Math.ceil(begin / tick - 1e-9); i * tick <= begin + this.shownSpan + 1e-9; i++) {
      const t = i * tick;
      c.beginPath(); c.moveTo(x(t), top); c.lineTo(x(t), height - axis); c.stroke();
      c.textAlign = x(t) > right - 20 ? "right" : "center";
      c.fillText(axisTime(t), Math.min(right, x(t)), height - axis / 2);
    }

    // firings
    const timed = ink("--accent"), immediate = ink("--ink-3");
    const y0 = top + step / 2;
    c.textAlign = "left";
    c.fillStyle = ink("--ink-2");
    if (step >= 8) c.fillText("firings", 14, y0);
    for (let i = model.indexAfter(model.board.n) - 1; i >= 0; i--) {
      const event = model.events[i];
      if (event.t < begin) break;
      if (event.k !== "fire") continue;
      c.fillStyle = model.scene.transitions[event.tr].timed ? timed : immediate;
      c.fillRect(x(event.t) - 0.75, y0 - step * 0.32, 1.5, step * 0.64);
    }

    // robots
    names.forEach((name, row) => {
      const y = top + step * (row + 1);
      const colour = colourOf(name);
      c.fillStyle = ink("--ink-2");
      c.textAlign = "left";
      if (step >= 8) c.fillText(name.length > 12 ? `${name.slice(0, 11)}…` : name, 14, y + step / 2);
      for (const [from, to, place, phase] of lanes.get(name).parts) {
        if (to < begin) continue;
        const a = Math.max(LABEL, x(from)), b = x(to);
        const bar = Math.max(2, step - 5);
        const waits = phase === "done" || phase === "waiting";
        c.globalAlpha = waits ? 0.32 : phase === "inactive" ? 0.18 : 0.85;
        c.fillStyle = phase === "lost" || phase === "failed" ? ink("--bad") : colour;
        c.fillRect(a, y + 2, Math.max(1, b - a - 1), bar);
        c.globalAlpha = 1;
        const label = phase === "lost" ? "lost" : model.scene.places[place]?.name || "";
        if (b - a > 34 && step >= 14) {
          c.fillStyle = waits || phase === "inactive" ? ink("--ink") : "#fff";
          c.textAlign = "left";
          c.save();
          c.beginPath(); c.rect(a + 3, y, b - a - 7, step); c.clip();
          c.fillText(label, a + 5, y + 2 + bar / 2);
          c.restore();
        }
      }
    });
    this.drawScrubber();
    this.cost = performance.now() - begun;
  }

  drawScrubber() {
    const { model } = this;
    const range = $("scrubber");
    range.min = model.oldest;
    range.max = Math.max(model.head.n, model.oldest);
    if (document.activeElement !== range || !this.sliding) range.value = model.following ? model.head.n : model.board.n;
    range.setAttribute("aria-valuetext", `event ${model.board.n} of ${model.head.n}, ${seconds(model.board.t)}`);
    $("position").textContent = `${seconds(model.now())}   ·   ${model.board.n} / ${model.head.n}`;
    $("back-to-live").hidden = model.following || model.mode === "REPLAY";
    $("back-to-live").textContent = model.mode === "LIVE" ? "Back to live" : "Back to now";
  }

  clicked(event) {
    const { left } = this.canvas.getBoundingClientRect();
    const { begin, end, right } = this.scale;
    const t = begin + ((event.clientX - left - LABEL) / (right - LABEL)) * (end - begin);
    const { events, board } = this.model;
    let found = null;
    for (const e of events) { if (e.t > t || e.n > board.n) break; found = e; }
    if (found) this.dispatchEvent(new CustomEvent("visit", { detail: found.n }));
  }

  close() {
    this.observer.disconnect();
    clearInterval(this.clock);
    clearTimeout(this.timer);
  }
}
