// The room beside the net: walls and places of interest from the world, the robots where they are.

import { $, h } from "./dom.js";
import { colourOf, shortName } from "./colours.js";

export class Room {
  constructor(model) {
    this.model = model;
    this.box = $("room");
    this.canvas = this.box.querySelector("canvas");
    this.shown = false;
    this.box.hidden = true;
    $("room-close").onclick = () => this.toggle(false);
  }

  toggle(on = !this.shown) {
    this.shown = on;
    this.box.hidden = !on;
    if (on) this.update();
  }

  /** Shown by itself the first time that a world is heard of. */
  news() {
    if (!this.offered && this.model.latest.room) {
      this.offered = true;
      this.toggle(true);
      return true;
    }
    if (this.shown && !this.frame) this.frame = requestAnimationFrame(() => { this.frame = 0; this.update(); });
    return false;
  }

  update() {
    const room = this.model.latest.room, world = this.model.latest.world;
    const c = this.canvas.getContext("2d");
    const ratio = window.devicePixelRatio || 1;
    const [x0, y0, x1, y1] = extent(room);
    const width = 300, height = Math.round(Math.min(300, Math.max(150, (width * (y1 - y0)) / (x1 - x0))));
    if (this.canvas.width !== width * ratio || this.canvas.height !== height * ratio) {
      this.canvas.width = width * ratio;
      this.canvas.height = height * ratio;
      this.canvas.style.width = `${width}px`;
      this.canvas.style.height = `${height}px`;
    }
    const k = Math.min(width / (x1 - x0), height / (y1 - y0)) * 0.94;
    const at = ([x, y]) => [width / 2 + (x - (x0 + x1) / 2) * k, height / 2 - (y - (y0 + y1) / 2) * k];
    const style = getComputedStyle(document.body);
    const ink = (name) => style.getPropertyValue(name).trim();
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, width, height);
    if (!room) return;
    c.fillStyle = ink("--node-line");
    for (const shape of room.walls || []) polygon(c, corners(shape).map(at));
    c.fillStyle = ink("--line");
    for (const shape of room.obstacles || []) polygon(c, corners(shape).map(at));
    c.font = "10px system-ui, sans-serif";
    c.textAlign = "center";
    for (const [name, spot] of Object.entries(room.locations || {})) {
      const [x, y] = at([spot.x ?? spot[0], spot.y ?? spot[1]]);
      c.strokeStyle = ink("--accent");
      c.beginPath(); c.arc(x, y, 6, 0, 7); c.stroke();
      c.fillStyle = ink("--ink-2");
      c.fillText(name, x, y + 16);
    }
    for (const robot of world?.robots || []) {
      const [x, y] = at([robot.x, robot.y]);
      const radius = Math.max(6, (robot.radius || 0.2) * k);
      c.fillStyle = colourOf(robot.name);
      c.beginPath(); c.arc(x, y, radius, 0, 7); c.fill();
      const theta = robot.theta ?? robot.yaw ?? 0;
      c.strokeStyle = "#fff";
      c.beginPath(); c.moveTo(x + Math.cos(theta) * radius * 0.45, y - Math.sin(theta) * radius * 0.45);
      c.lineTo(x + Math.cos(theta) * radius, y - Math.sin(theta) * radius); c.lineWidth = 2; c.stroke(); c.lineWidth = 1;
      c.fillStyle = "#fff";
      c.textBaseline = "middle";
      c.fillText(shortName(robot.name), x, y);
      c.textBaseline = "alphabetic";
    }
  }
}

function corners(shape) {
  if (Array.isArray(shape)) {
    return typeof shape[0] === "number" ? [[shape[0], shape[1]], [shape[2], shape[1]], [shape[2], shape[3]], [shape[0], shape[3]]] : shape;
  }
  if (shape.points) return shape.points;
  return [];
}

function extent(room) {
  let [x0, y0, x1, y1] = [Infinity, Infinity, -Infinity, -Infinity];
  for (const shape of [...(room?.walls || []), ...(room?.obstacles || [])]) {
    for (const [x, y] of corners(shape)) { x0 = Math.min(x0, x); y0 = Math.min(y0, y); x1 = Math.max(x1, x); y1 = Math.max(y1, y); }
  }
  return Number.isFinite(x0) ? [x0, y0, x1, y1] : [0, 0, 10, 10];
}

function polygon(c, points) {
  c.beginPath();
  points.forEach(([x, y], i) => (i ? c.lineTo(x, y) : c.moveTo(x, y)));
  c.closePath();
  c.fill();
}
