// The room next to the net: walls and locations from the world, and the robots at their positions.

import { $ } from "./dom.js";
import { colourOf, shortName } from "./colours.js";
import { trace } from "./geometry.js";

const WIDEST = 300; // px
const SHARE = 0.5; // largest share of the panel's height

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

  /** Draw the latest positions; the panel opens by itself at the first report of a world. */
  news() {
    if (!this.offered && this.model.latest.room) {
      this.offered = true;
      this.toggle(true);
      return true;
    }
    if (this.shown && !this.frame)
      this.frame = requestAnimationFrame(() => {
        this.frame = 0;
        this.update();
      });
    return false;
  }

  update() {
    const room = this.model.latest.room,
      world = this.model.latest.world;
    const c = this.canvas.getContext("2d");
    const ratio = window.devicePixelRatio || 1;
    const [x0, y0, x1, y1] = extent(room);
    const { clientWidth, clientHeight } = this.box.parentElement;
    const width = Math.min(WIDEST, clientWidth - 28);
    const height = Math.round(
      Math.min(WIDEST, clientHeight * SHARE, Math.max(150, (width * (y1 - y0)) / (x1 - x0))),
    );
    const { canvas } = this;
    if (canvas.width !== width * ratio || canvas.height !== height * ratio) {
      Object.assign(canvas, { width: width * ratio, height: height * ratio });
      Object.assign(canvas.style, { width: `${width}px`, height: `${height}px` });
    }
    const k = Math.min(width / (x1 - x0), height / (y1 - y0)) * 0.94;
    const at = ([x, y]) => [
      width / 2 + (x - (x0 + x1) / 2) * k,
      height / 2 - (y - (y0 + y1) / 2) * k,
    ];
    const style = getComputedStyle(document.body);
    const ink = (name) => style.getPropertyValue(name).trim();
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, width, height);
    if (!room) return;
    for (const location of Object.values(room.locations || {})) {
      c.fillStyle = ink("--accent-soft");
      polygon(c, rectangle(location.area).map(at));
    }
    for (const spot of world?.hot_spots || []) {
      const [x, y] = at(spot.at);
      disc(c, x, y, spot.radius * k, "rgba(214, 72, 40, .35)");
    }
    c.fillStyle = ink("--node-line");
    for (const box of room.boxes || []) polygon(c, boxCorners(box).map(at));
    for (const pillar of room.cylinders || []) {
      disc(c, ...at(pillar.at), pillar.radius * k, ink("--node-line"));
    }
    c.font = "600 10px system-ui, sans-serif";
    c.textAlign = "center";
    c.fillStyle = ink("--ink-2");
    for (const [name, { area }] of Object.entries(room.locations || {})) {
      const [x, y] = at([(area[0][0] + area[1][0]) / 2, (area[0][1] + area[1][1]) / 2]);
      c.fillText(name, x, y + 3);
    }
    for (const [name, robot] of Object.entries(world?.robots || {})) {
      if (robot.path?.length > 1) {
        c.strokeStyle = colourOf(name);
        c.globalAlpha = 0.5;
        c.setLineDash([4, 3]);
        trace(c, robot.path.map(at));
        c.stroke();
        c.setLineDash([]);
        c.globalAlpha = 1;
      }
    }
    for (const person of world?.people || []) {
      const [x, y] = at(person.at);
      const radius = Math.max(7, person.radius * k);
      disc(c, x, y, radius, person.color, 0.7);
      disc(c, x, y, radius * 0.4, ink("--ink"));
    }
    for (const [name, robot] of Object.entries(world?.robots || {})) {
      const [px, py, yaw] = robot.pose;
      const [x, y] = at([px, py]);
      const radius = Math.max(7, (room.robot_radius || 0.2) * k);
      disc(c, x, y, radius, colourOf(name));
      c.strokeStyle = colourOf(name);
      c.lineWidth = 2.5;
      c.beginPath();
      c.moveTo(x + Math.cos(yaw) * radius, y - Math.sin(yaw) * radius);
      c.lineTo(x + Math.cos(yaw) * (radius + 5), y - Math.sin(yaw) * (radius + 5));
      c.stroke();
      c.lineWidth = 1;
      c.fillStyle = "#fff";
      c.textBaseline = "middle";
      c.fillText(shortName(name), x, y + 0.5);
      c.textBaseline = "alphabetic";
    }
  }
}

const rectangle = ([[x0, y0], [x1, y1]]) => [
  [x0, y0],
  [x1, y0],
  [x1, y1],
  [x0, y1],
];

function boxCorners({ at: [x, y], size: [w, d], yaw = 0 }) {
  const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
  return [
    [-w / 2, -d / 2],
    [w / 2, -d / 2],
    [w / 2, d / 2],
    [-w / 2, d / 2],
  ].map(([a, b]) => [x + a * c - b * s, y + a * s + b * c]);
}

function extent(room) {
  if (!room?.bounds) return [0, 0, 10, 10];
  const [[x0, y0], [x1, y1]] = room.bounds;
  return [x0, y0, x1, y1];
}

/** A disc, or an ellipse so many times as high as it is wide. */
function disc(c, x, y, radius, colour, height = 1) {
  c.fillStyle = colour;
  c.beginPath();
  c.ellipse(x, y, radius, radius * height, 0, 0, 7);
  c.fill();
}

function polygon(c, points) {
  trace(c, points);
  c.closePath();
  c.fill();
}
