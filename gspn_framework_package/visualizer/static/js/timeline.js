// The time line: a lane of firings, and below it a lane per robot in its colour (paler while it waits). A simulation
// has no robots, so the lanes show token counts of places. The scrubber is below.

import { $, firstWhere, attempt, natural, options, seconds } from "./dom.js";
import { colourOf } from "./colours.js";
import { courseOf, lanesOf } from "./course.js";
import { trace } from "./geometry.js";
import { reportOf, robotReport } from "./phases.js";
import { RestingList } from "./resting_list.js";

const SPANS = [1, 2, 5, 10, 30, 60, 300, 1200, 7200, 86400];
const TICKS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 1800, 3600, 14400]; // s
const LABEL = [92, 0.22]; // width of the lane names: least in px, and largest as a share of the width
const LANE = [15, 26]; // px, least and largest height of a lane; if they do not all fit, they scroll
const TOKENS = 20; // px, least height of a lane of tokens
const EDGE = [26, 4]; // px above the lanes, for the axis, and below them

const spanText = (t) => (t < 60 ? `${t} s` : t < 3600 ? `${t / 60} min` : `${t / 3600} h`);
const axisTime = (t) => (t < 60 ? `${Number(t.toFixed(1))} s` : seconds(t));

/** Index of the first event at or after `t`; `events` are sorted by time. */
const firstAt = (events, t) => firstWhere(events, (event) => event.t >= t);

const PAUSE = 90; // ms between two drawings

/** Fires "visit" (detail n). */
export class TimeLine extends RestingList {
  constructor(model) {
    super($("lanes"), PAUSE);
    this.model = model;
    this.canvas = this.list;
    this.span = null; // seconds shown; null: chosen automatically
    this.canvas.onclick = (event) => this.clicked(event);
    this.canvas.onwheel = (event) => {
      const { scrollHeight, clientHeight } = this.canvas.parentElement;
      if (scrollHeight > clientHeight + 1 && !event.ctrlKey) return; // then the wheel scrolls the lanes
      event.preventDefault();
      this.zoom(event.deltaY > 0 ? 1 : -1);
    };
    this.canvas.onkeydown = (event) => this.key(event);
    const spans = $("span");
    spans.replaceChildren(
      ...options([["", "auto"], ...SPANS.map((span) => [span, spanText(span)])]),
    );
    spans.onchange = () => {
      this.span = Number(spans.value) || null;
      this.update();
    };
    this.observer = new ResizeObserver(() => this.update());
    this.observer.observe(this.canvas.parentElement);
    this.clock = setInterval(() => {
      if (
        model.mode === "LIVE" &&
        model.following &&
        model.lostAt === null &&
        model.board?.status.running
      )
        this.later();
    }, 200);
  }

  /** Show more of the run (1), or less (-1). */
  zoom(direction) {
    const at = SPANS.indexOf(this.shownSpan || 30);
    this.span = SPANS[Math.max(0, Math.min(SPANS.length - 1, at + direction))];
    $("span").value = this.span;
    this.update();
  }

  key(event) {
    const { model } = this;
    const visit = (n) => this.dispatchEvent(new CustomEvent("visit", { detail: n }));
    const act = {
      ArrowRight: () => model.stepView(1),
      ArrowLeft: () => model.stepView(-1),
      Home: () => visit(model.oldest),
      End: () => visit(model.head.n),
      PageUp: () => visit(this.eventAt(model.board.t + this.shownSpan / 2)),
      PageDown: () => visit(this.eventAt(model.board.t - this.shownSpan / 2)),
      "+": () => this.zoom(-1),
      "-": () => this.zoom(1),
    }[event.key];
    if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    event.stopPropagation();
    attempt(act);
  }

  /** Number of the last loaded event at or before `t`. */
  eventAt(t) {
    const { events, mode, oldest } = this.model;
    const course = mode === "SIMULATE" ? courseOf(this.model) : events;
    const index = firstAt(course, t + 1e-9);
    return index > 0 ? course[index - 1].n : oldest;
  }

  /** The token counts of places since `begin`: of the selected place and of those that changed most often, at most
   * `count`, in natural order. [{name, points: [[from, tokens], ...], most}, ...] */
  tokens(begin, count) {
    const { model } = this;
    const { marking } = model.board;
    const course = courseOf(model);
    const last = course.length,
      first = firstAt(course, begin);
    const changes = new Map(); // place -> number of changes
    for (let i = first; i < last; i++) {
      for (const [p] of course[i].d || []) changes.set(p, (changes.get(p) || 0) + 1);
    }
    const chosen = window.gspn?.page.selection;
    if (chosen?.kind === "place") changes.set(chosen.index, Infinity);
    const order = changes.size
      ? [...changes].sort((a, b) => b[1] - a[1]).map(([p]) => p)
      : marking.map((_, p) => p).filter((p) => marking[p] > 0);
    const wanted = order.slice(0, Math.max(0, count));
    let from = first; // after the last reset: earlier events are ignored
    for (let i = first; i < last; i++) if (course[i].k === "mark") from = i;
    const counts = new Map(wanted.map((p) => [p, marking[p]]));
    for (let i = from; i < last; i++) {
      for (const [p, change] of course[i].d || [])
        if (counts.has(p)) counts.set(p, counts.get(p) - change);
    }
    const points = new Map(
      wanted.map((p) => [p, [[from === first ? begin : course[from].t, counts.get(p)]]]),
    );
    for (let i = from; i < last; i++) {
      const event = course[i];
      for (const [p, change] of event.d || []) {
        if (!counts.has(p)) continue;
        counts.set(p, counts.get(p) + change);
        points.get(p).push([event.t, counts.get(p)]);
      }
    }
    return wanted
      .map((p) => ({
        name: model.scene.places[p].name,
        points: points.get(p),
        most: Math.max(...points.get(p).map(([, tokens]) => tokens)),
      }))
      .sort((a, b) => natural(a.name, b.name));
  }

  draw() {
    const { model, canvas } = this;
    if (!model.board) return;
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth: width, clientHeight: shown } = canvas.parentElement;
    if (!width || !shown) {
      this.drawScrubber();
      return;
    } // the lanes are folded
    const end = model.now();
    const course = courseOf(model);
    const have = course.length ? end - course[0].t : 0;
    this.shownSpan = this.span || SPANS.find((span) => span >= Math.min(have, 60)) || 60;
    const begin = Math.max(0, end - this.shownSpan); // a short run starts at the left
    const lanes = lanesOf(model, begin, end);
    const names = [...lanes.keys()].sort(natural);
    const [top, bottom] = EDGE;
    const places =
      model.mode === "SIMULATE"
        ? this.tokens(begin, Math.floor((shown - top - bottom) / TOKENS) - 1)
        : [];
    const rows = names.length + places.length + 1;
    const height = Math.max(shown, top + bottom + rows * LANE[0]);
    const step = Math.min(LANE[1], (height - top - bottom) / rows);
    canvas.style.height = height > shown ? `${height}px` : "100%";
    const [wide, high] = [width, height].map((length) => Math.round(length * ratio));
    if (canvas.width !== wide || canvas.height !== high)
      Object.assign(canvas, { width: wide, height: high });
    const style = getComputedStyle(document.body);
    const ink = (name) => style.getPropertyValue(name).trim();
    const c = canvas.getContext("2d");
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, width, height);
    c.font = "11px system-ui, sans-serif";
    c.textBaseline = "middle";
    const widest = Math.max(
      0,
      ...names.concat(places.map((place) => place.name)).map((name) => c.measureText(name).width),
    );
    const label = Math.max(LABEL[0], Math.min(widest + 26, width * LABEL[1])),
      right = width - 14;
    const fitted = (name) => {
      let text = name;
      for (let length = name.length; length > 1 && c.measureText(text).width > label - 24; length--)
        text = `${name.slice(0, length - 1)}…`;
      return text;
    };
    const x = (t) => label + ((t - begin) / this.shownSpan) * (right - label);
    this.scale = { begin, end: begin + this.shownSpan, left: label, right };

    // the axis
    c.strokeStyle = ink("--line-soft");
    c.fillStyle = ink("--ink-3");
    c.textAlign = "center";
    const tick =
      TICKS.find((length) => (length / this.shownSpan) * (right - label) >= 70) || this.shownSpan;
    for (let i = Math.ceil(begin / tick - 1e-9); i * tick <= begin + this.shownSpan + 1e-9; i++) {
      const t = i * tick;
      c.beginPath();
      c.moveTo(x(t), top - 4);
      c.lineTo(x(t), height - bottom);
      c.stroke();
      c.textAlign = x(t) > right - 20 ? "right" : "center";
      c.fillText(axisTime(t), Math.min(right, x(t)), top / 2);
    }

    // firings
    const timed = ink("--accent"),
      eventful = ink("--warn"),
      immediate = ink("--ink-3");
    const y0 = top + step / 2;
    c.textAlign = "left";
    c.fillStyle = ink("--ink-2");
    if (step >= 8) c.fillText("firings", 14, y0);
    let drawn = Infinity; // position of the last firing drawn: at most one per pixel
    for (let i = course.length - 1; i >= 0; i--) {
      const event = course[i];
      if (event.t < begin) break;
      if (event.k !== "fire" || drawn - x(event.t) < 0.5) continue;
      drawn = x(event.t);
      const transition = model.sceneOf(event).transitions[event.tr];
      const tall = transition.event ? 0.46 : 0.32; // firings by events are taller
      c.fillStyle = transition.event ? eventful : transition.timed ? timed : immediate;
      c.fillRect(x(event.t) - 0.75, y0 - step * tall, 1.5, step * tall * 2);
    }

    // robots
    names.forEach((name, row) => {
      const y = top + step * (row + 1);
      const colour = colourOf(name);
      c.fillStyle = ink("--ink-2");
      c.textAlign = "left";
      if (step >= 8) c.fillText(fitted(name), 14, y + step / 2);
      let reached = -Infinity;
      for (const [from, to, place, phase] of lanes.get(name).parts) {
        if (to < begin || x(to) - reached < 0.5) continue;
        reached = x(to);
        const a = Math.max(label, x(from)),
          b = x(to);
        const bar = Math.max(2, step - 5);
        const is = reportOf(phase);
        c.globalAlpha = is.waits ? 0.32 : is.at_rest ? 0.18 : 0.85;
        c.fillStyle = is.needs_operator ? ink("--bad") : colour;
        c.fillRect(a, y + 2, Math.max(1, b - a - 1), bar);
        c.globalAlpha = 1;
        const does = is.gone ? is.word : place;
        if (b - a > 34 && step >= 14) {
          c.fillStyle = is.waits || is.at_rest ? ink("--ink") : "#fff";
          c.textAlign = "left";
          c.save();
          c.beginPath();
          c.rect(a + 3, y, b - a - 7, step);
          c.clip();
          c.fillText(does, a + 5, y + 2 + bar / 2);
          c.restore();
        }
      }
    });
    places.forEach(({ name, points, most }, row) => {
      const base = top + step * (row + 2) - 4,
        rise = (step - 7) / Math.max(1, most);
      c.fillStyle = ink("--ink-2");
      c.textAlign = "left";
      c.fillText(fitted(name), 14, base - step / 2 + 4);
      const steps = points.flatMap(([t, count], i) =>
        [t, points[i + 1]?.[0] ?? end].map((at) => [Math.max(label, x(at)), base - count * rise]),
      );
      trace(c, [[steps[0][0], base], ...steps, [x(end), base]]);
      c.globalAlpha = 0.2;
      c.fillStyle = timed;
      c.fill();
      c.globalAlpha = 1;
      trace(c, steps);
      c.strokeStyle = timed;
      c.stroke();
      if (x(end) < right - 24) {
        c.fillStyle = ink("--ink-2");
        c.fillText(String(points[points.length - 1][1]), x(end) + 5, base - step / 2 + 4);
      }
    });
    this.drawScrubber();
  }

  drawScrubber() {
    const { model } = this;
    const range = $("scrubber");
    range.min = model.oldest;
    range.max = Math.max(model.head.n, model.oldest);
    if (document.activeElement !== range || !this.sliding)
      range.value = model.following ? model.head.n : model.board.n;
    range.setAttribute(
      "aria-valuetext",
      `event ${model.board.n} of ${model.head.n}, ${seconds(model.board.t)}`,
    );
    const { canvas } = this;
    canvas.setAttribute("aria-valuemin", model.oldest);
    canvas.setAttribute("aria-valuemax", Math.max(model.head.n, model.oldest));
    canvas.setAttribute("aria-valuenow", model.board.n);
    canvas.setAttribute("aria-valuetext", this.says());
    const reading = model.info.loading
      ? `   ·   reading the log: ${Math.floor(100 * (model.info.progress || 0))} %`
      : "";
    $("position").textContent =
      `${seconds(model.now())}   ·   ${model.board.n} / ${model.head.n}${reading}`;
    $("back-to-live").hidden = model.following || model.mode === "REPLAY";
    $("back-to-live").textContent = model.mode === "LIVE" ? "Back to live" : "Back to now";
  }

  /** The time and what each robot does, in words. */
  says() {
    const { board, scene, head } = this.model;
    const robots = [...board.robots.values()].sort((a, b) => natural(a.name, b.name)).slice(0, 8);
    const does = robots.map(
      (robot) =>
        `${robot.name} ${robotReport(robot, board.status).word}` +
        (robot.place >= 0 ? ` in ${scene.places[robot.place].name}` : "") +
        (robot.task ? ` with task ${robot.task[0]}` : ""),
    );
    return [`${seconds(board.t)}, event ${board.n} of ${head.n}`, ...does].join("; ");
  }

  clicked(event) {
    const { begin, end, left, right } = this.scale;
    const t =
      begin +
      ((event.clientX - this.canvas.getBoundingClientRect().left - left) / (right - left)) *
        (end - begin);
    const found = Math.min(this.eventAt(t), this.model.board.n);
    this.dispatchEvent(new CustomEvent("visit", { detail: found }));
  }

  close() {
    this.observer.disconnect();
    clearInterval(this.clock);
    super.close();
  }
}
