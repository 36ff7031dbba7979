// The room next to the net: the world's walls and locations, or the robots' map, and the robots at their positions.
// What is selected in the net is marked here, and a click here selects in the net.

import { $, h } from "./dom.js";
import { colourOf, shortName } from "./colours.js";
import { trace } from "./geometry.js";
import { PastPoses, turn } from "./past_poses.js";

const WIDEST = 640; // px
const SHARE = 0.5; // largest share of the panel's height
const [UNKNOWN, WALL] = [0, 2]; // cells of a map
const GLIDE = 90; // ms in which a robot has moved most of the way to where it was reported last
const NEAR = 0.002; // m; a robot closer than this has arrived

/** Fires "robot" (detail: its name) and "place" (detail: its index) when one is chosen here. */
export class Room extends EventTarget {
  constructor(model) {
    super();
    this.model = model;
    this.box = $("room");
    this.canvas = this.box.querySelector("canvas");
    this.shown = false;
    this.box.hidden = true;
    this.drawn = new Map(); // robot -> [x, y, yaw] as drawn now
    this.selection = null;
    this.picture = { of: null };
    this.past = new PastPoses(model, () => this.shown && this.later());
    $("room-close").onclick = () => this.toggle(false);
    this.canvas.onclick = (event) => this.click(event.offsetX, event.offsetY);
    this.note =
      this.box.querySelector(".room-note") || this.box.appendChild(h("p.room-note.muted"));
  }

  toggle(on = !this.shown) {
    this.shown = on;
    this.box.hidden = !on;
    if (on) this.update();
  }

  /** Draw the latest positions; the panel opens by itself at the first report of a world. */
  news() {
    if (!this.offered && (this.model.latest.room || this.model.latest.world)) {
      this.offered = true;
      this.toggle(true);
      return true;
    }
    if (this.shown) this.later();
    return false;
  }

  later() {
    if (this.frame) return;
    this.frame = requestAnimationFrame((now) => {
      this.frame = 0;
      this.update(now);
    });
  }

  /** Mark a place of the net and the robots in it; null: nothing. */
  select(selection) {
    this.selection = selection?.kind === "place" ? selection.index : null;
    if (this.shown) this.later();
  }

  /** Select what was clicked: a robot, or the place whose goal or location is there. */
  click(x, y) {
    const { model } = this;
    const hit = ([px, py], within) => Math.hypot(px - x, py - y) <= within;
    for (const [name, [px, py]] of [...this.drawn].reverse()) {
      if (!hit(this.at([px, py]), this.radius + 3)) continue;
      this.dispatchEvent(new CustomEvent("robot", { detail: name }));
      return;
    }
    const goal = model.scene.places.findIndex((place) => place.at && hit(this.at(place.at), 10));
    const inside = ({ area }) => {
      const [[left, low], [right, high]] = area.map((corner) => this.at(corner));
      return x >= left && x <= right && y <= low && y >= high;
    };
    const location = Object.entries(model.latest.room?.locations || {}).find(([, one]) =>
      inside(one),
    );
    const place = goal >= 0 ? goal : location ? placesAt(model.scene, location[0])[0] : undefined;
    if (place !== undefined) this.dispatchEvent(new CustomEvent("place", { detail: place }));
  }

  /** The world at the time shown; of the past, only where the robots were is known. */
  world() {
    const { model } = this;
    return model.following ? model.latest.world : { robots: this.past.at(model.now()) };
  }

  /** Let robots glide to where they are reported; true while any is on its way. */
  glide(now, robots = {}) {
    const share = this.before ? 1 - Math.exp((this.before - now) / GLIDE) : 1;
    let moving = false;
    for (const name of this.drawn.keys()) if (!(name in robots)) this.drawn.delete(name);
    for (const [name, { pose }] of Object.entries(robots)) {
      const known = this.drawn.get(name);
      const far = known ? Math.hypot(pose[0] - known[0], pose[1] - known[1]) : 0;
      if (!known || far < NEAR) {
        this.drawn.set(name, [...pose]);
        continue;
      }
      moving = true;
      this.drawn.set(name, [
        known[0] + share * (pose[0] - known[0]),
        known[1] + share * (pose[1] - known[1]),
        known[2] + share * turn(known[2], pose[2]),
      ]);
    }
    this.before = moving ? now : 0;
    return moving;
  }

  update(now = performance.now()) {
    const { room } = this.model.latest;
    const world = this.world();
    if (this.glide(now, world?.robots) || this.model.playing) this.later();
    const { places } = this.model.scene;
    const c = this.canvas.getContext("2d");
    const ratio = window.devicePixelRatio || 1;
    const goals = places.map((place) => place.at).filter(Boolean);
    const [x0, y0, x1, y1] = extent(room, [...this.drawn.values(), ...goals]);
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
    const at = (this.at = ([x, y]) => [
      width / 2 + (x - (x0 + x1) / 2) * k,
      height / 2 - (y - (y0 + y1) / 2) * k,
    ]);
    const style = getComputedStyle(document.body);
    const ink = (name) => style.getPropertyValue(name).trim();
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, width, height);
    this.tell(world);
    if (room?.grid) this.drawMap(c, room, at, ink);
    this.drawPlaces(c, room, at, ink);
    for (const spot of world?.hot_spots || []) {
      const [x, y] = at(spot.at);
      disc(c, x, y, spot.radius * k, "rgba(214, 72, 40, .35)");
    }
    c.fillStyle = ink("--node-line");
    for (const box of room?.boxes || []) polygon(c, boxCorners(box).map(at));
    for (const pillar of room?.cylinders || []) {
      disc(c, ...at(pillar.at), pillar.radius * k, ink("--node-line"));
    }
    this.drawNames(c, room, at, ink);
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
    this.radius = Math.max(7, (room?.robot_radius || 0.2) * k);
    for (const [name, pose] of this.drawn) this.drawRobot(c, name, pose, at, ink);
  }

  drawMap(c, room, at, ink) {
    const colours = [ink("--node-line"), ink("--sheet")];
    const { picture } = this;
    if (picture.of !== room || picture.ink !== colours[0])
      this.picture = {
        of: room,
        ink: colours[0],
        canvas: mapPicture(room.grid, ...colours),
      };
    const [[left, low], [right, high]] = room.bounds.map(at);
    c.imageSmoothingEnabled = false;
    c.drawImage(this.picture.canvas, left, high, right - left, low - high);
  }

  /** The locations of a world, and the goals of places; those of the selected place stand out. */
  drawPlaces(c, room, at, ink) {
    const { places } = this.model.scene;
    const chosen = places[this.selection];
    for (const [name, location] of Object.entries(room?.locations || {})) {
      const corners = rectangle(location.area).map(at);
      c.fillStyle = ink("--accent-soft");
      polygon(c, corners);
      if (!chosen || !words(chosen.name).includes(name)) continue;
      c.strokeStyle = ink("--accent");
      c.lineWidth = 2.5;
      c.stroke();
      c.lineWidth = 1;
    }
    for (const place of places) {
      if (!place.at) continue;
      const [x, y] = at(place.at);
      disc(c, x, y, place === chosen ? 8 : 5, ink(place === chosen ? "--accent" : "--ink-3"));
    }
  }

  drawNames(c, room, at, ink) {
    c.font = "600 10px system-ui, sans-serif";
    c.textAlign = "center";
    c.fillStyle = ink("--ink-2");
    for (const [name, { area }] of Object.entries(room?.locations || {})) {
      const [x, y] = at([(area[0][0] + area[1][0]) / 2, (area[0][1] + area[1][1]) / 2]);
      c.fillText(name, x, y + 3);
    }
    const named = new Set(); // several places may have one goal
    for (const place of this.model.scene.places) {
      if (!place.at || named.has(String(place.at))) continue;
      named.add(String(place.at));
      const [x, y] = at(place.at);
      c.fillText(place.name, x, y + 16);
    }
  }

  drawRobot(c, name, [px, py, yaw], at, ink) {
    const { radius } = this;
    const [x, y] = at([px, py]);
    const place = this.model.board?.robots.get(name)?.place;
    if (this.selection !== null && place === this.selection)
      disc(c, x, y, radius + 4, ink("--accent"));
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

  /** Say what the positions are, and where each robot is, for those who do not see the drawing. */
  tell(world) {
    const { model } = this;
    const robots = Object.entries(world?.robots || {});
    const guessed = robots.filter(([, { by }]) => by === "odom").map(([name]) => name);
    const says = guessed.length
      ? `By odometry, each from its own start: ${guessed.join(", ")}.`
      : "";
    if (this.note.textContent !== says) this.note.textContent = says;
    const seen = robots.map(([name]) => {
      const place = model.board?.robots.get(name)?.place;
      return place >= 0 ? `${name} in ${model.scene.places[place]?.name}` : name;
    });
    const label = `The room and the robots in it: ${seen.join(", ") || "none is seen"}`;
    if (this.canvas.getAttribute("aria-label") !== label)
      this.canvas.setAttribute("aria-label", label);
  }
}

/** The words of a name: "Wait_L1" is in the location "L1". */
const words = (name) => name.split(/[^A-Za-z0-9]+/);

/** The places of a location, by their indices. */
const placesAt = (scene, location) =>
  scene.places
    .map((_, index) => index)
    .filter((i) => words(scene.places[i].name).includes(location));

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

/** The corners of what is shown: the room or map; without one, whatever the robots and goals span. */
function extent(room, points) {
  if (room?.bounds) return room.bounds.flat();
  if (!points.length) return [0, 0, 10, 10];
  const [xs, ys] = [0, 1].map((i) => points.map((point) => point[i]));
  return [Math.min(...xs) - 1, Math.min(...ys) - 1, Math.max(...xs) + 1, Math.max(...ys) + 1];
}

/** A map of cells as a picture: walls in `ink`, what is free in `paper`; the first row is the lowest. */
function mapPicture({ width, height, runs }, ink, paper) {
  const picture = Object.assign(document.createElement("canvas"), { width, height });
  const c = picture.getContext("2d");
  let cell = 0;
  for (let i = 0; i < runs.length; i += 2) {
    c.fillStyle = runs[i] === WALL ? ink : paper;
    let left = runs[i + 1];
    while (left > 0) {
      const [x, y] = [cell % width, Math.floor(cell / width)];
      const length = Math.min(left, width - x);
      if (runs[i] !== UNKNOWN) c.fillRect(x, height - 1 - y, length, 1);
      cell += length;
      left -= length;
    }
  }
  return picture;
}

/** A disc, or an ellipse; the number is its height divided by its width. */
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
