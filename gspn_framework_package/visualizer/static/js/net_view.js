// The net as SVG: three layers (arcs, nodes, travelling tokens) under one transform.
// Changes are collected and drawn once per frame.

import { h, s } from "./dom.js";
import { Arcs } from "./net_arcs.js";
import { boundsOf } from "./arc_routes.js";
import { Camera } from "./net_camera.js";
import { Pointer } from "./net_pointer.js";
import {
  buildPlace,
  buildTransition,
  drawPlace,
  drawLost,
  drawEnabled,
  paintNode,
  follow,
  settle,
} from "./net_nodes.js";
import { KeptPositions } from "./kept_positions.js";
import { Travel } from "./travel.js";
import { Labels } from "./labels.js";
import { reportOf } from "./phases.js";
import { Subnets } from "./subnets.js";

const TILED = 800; // nets with more nodes are drawn in tiles
const TILE = 40; // nodes in a tile
const MANY = 2000; // in nets with more nodes, only every other frame is drawn
const FLASH = 160; // ms

/** Fires "select" (detail {kind, index}), "activate" (double click) and "frame" (detail.n, after drawing). */
export class NetView extends EventTarget {
  /** `folds`: the element that contains the list of the plan's subnets. */
  constructor(container, model, folds) {
    super();
    this.container = container;
    this.model = model;
    this.scene = model.scene;
    this.dirty = { places: new Set(), transitions: new Set() };
    this.pending = new Map(); // place -> number of tokens still on their way there
    this.pendingRobots = new Map();
    this.selection = null;
    this.renamed = false; // whether the whole board has changed since it was drawn
    this.kept = new KeptPositions(this.scene.hash);
    this.nodes = [];
    this.put(this.scene.layout);
    this.subnets = new Subnets(this, folds);
    this.build();
    this.travel = new Travel(this);
    this.labels = new Labels(this);
    this.camera = new Camera(this);
    this.pointer = new Pointer(this);
  }

  // -- building ------------------------------------------------------------------------------------

  /** Give every node its position: from the layout, or where it was dragged to. */
  put(layout) {
    const { scene } = this;
    const moved = this.kept.read();
    const make = (kind, index, [x, y], name) => {
      const node = this.nodes[index + (kind === "place" ? 0 : scene.places.length)] || {
        kind,
        index,
        name,
      };
      node.home = moved.get(name) || [x, y]; // [node.x, node.y], except for subnets
      [node.x, node.y] = node.home;
      node.moved = moved.has(name);
      return node;
    };
    this.places = scene.places.map((p, i) => make("place", i, layout.places[i], p.name));
    this.transitions = scene.transitions.map((t, i) =>
      make(t.timed ? "timed" : "immediate", i, layout.transitions[i], t.name),
    );
    this.nodes = [...this.places, ...this.transitions];
  }

  build() {
    const { scene } = this;
    this.arcs = new Arcs(scene, this.places, this.transitions);
    this.arcs.layer.prepend(this.subnets.boxes);
    this.layer = { arcs: this.arcs.layer, travel: s("g") };
    const sheet = (name, ...content) =>
      s("svg", { class: name, "aria-hidden": "true" }, ...content);
    this.tiles = new Map();
    for (const node of this.nodes) {
      if (node.kind === "place") buildPlace(node, scene.places[node.index]);
      else buildTransition(node, scene.transitions[node.index]);
      this.tileOf(node).append(node.element);
    }
    const counts = `${scene.places.length} places, ${scene.transitions.length} transitions`;
    const says = `The net: ${counts}. Use the list to browse it.`;
    const nodes = h(
      "div.nodes",
      { role: "img", "aria-label": says },
      [...this.tiles.values()].map((tile) => sheet("tile", tile)),
    );
    this.container.replaceChildren(
      sheet("arcs", this.layer.arcs),
      nodes,
      sheet("travel", this.layer.travel),
    );
    this.moving = [...Object.values(this.layer), ...this.tiles.values()];
    this.redraw();
  }

  /** The group of nearby nodes that a node is drawn in: groups that do not change are not redrawn. */
  tileOf(node) {
    const many = this.nodes.length > TILED;
    if (many && !this.tileSize) {
      const [x0, y0, x1, y1] = this.bounds();
      this.tileSize = Math.sqrt(((x1 - x0) * (y1 - y0) * TILE) / this.nodes.length);
    }
    const key = many
      ? `${Math.floor(node.x / this.tileSize)},${Math.floor(node.y / this.tileSize)}`
      : "";
    if (!this.tiles.has(key)) this.tiles.set(key, s("g"));
    return this.tiles.get(key);
  }

  bounds() {
    return boundsOf(this.nodes, this.arcs.all, 24, 32) || [0, 0, 100, 100];
  }

  // -- the board -----------------------------------------------------------------------------------

  reset() {
    this.travel.clear();
    this.pending.clear();
    this.pendingRobots.clear();
    for (let p = 0; p < this.places.length; p++) this.dirty.places.add(p);
    for (let t = 0; t < this.transitions.length; t++) this.dirty.transitions.add(t);
    this.renamed = true;
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
        for (let p = 0; p < this.places.length; p++)
          if (this.places[p].robots || this.places[p].lost) this.dirty.places.add(p);
        for (const { name } of event.r) {
          const place = this.model.board.robots.get(name)?.place;
          if (place >= 0) this.dirty.places.add(place);
        }
      }
    }
    this.request();
  }

  request() {
    if (this.frame) return;
    this.frame = requestAnimationFrame(() => this.draw());
  }

  /** Whether this frame is skipped: only in a large net whose view does not move. */
  skips() {
    this.odd = !this.odd;
    return this.odd && this.nodes.length > MANY && !this.camera.dirty && !this.pointer.gesture;
  }

  draw() {
    this.frame = 0;
    if (this.skips()) {
      this.request();
      return;
    }
    const { board } = this.model;
    if (this.camera.dirty) {
      this.camera.draw();
      this.labels.later();
    }
    if (!board) return;
    const changed = this.dirty.places.size + this.dirty.transitions.size > 0;
    if (this.dirty.places.size) {
      const { here, lost } = this.robotsByPlace(board);
      const count = (p) => board.marking[p] - (this.pending.get(p) || 0);
      for (const p of this.dirty.places) {
        const entry = this.subnets.behind.get(p);
        if (entry !== undefined) this.dirty.places.add(entry); // iteration over a set includes elements added meanwhile
        drawPlace(this.places[p], this.subnets.tokens(p, count), here.get(p) || []);
        if (lost.has(p) || this.places[p].lost) drawLost(this.places[p], lost.get(p) || []);
      }
      this.dirty.places.clear();
      this.subnets.count(board);
    }
    for (const t of this.dirty.transitions) drawEnabled(this.transitions[t], board.enabled.has(t));
    this.dirty.transitions.clear();
    // The ranks of the names depend on what has just been drawn; requested earlier, the names could be placed before
    // that.
    if (this.renamed) this.labels.later();
    else if (changed) this.labels.follow();
    this.renamed = false;
    this.travel.begin();
    this.dispatchEvent(new CustomEvent("frame", { detail: { n: board.n } }));
  }

  /** The robots in each place, except those still on their way, and those that were lost there: place -> robots. */
  robotsByPlace(board) {
    const [here, lost] = [new Map(), new Map()];
    for (const robot of board.robots.values()) {
      if (
        robot.place === undefined ||
        robot.place < 0 ||
        !reportOf(robot.phase).shown ||
        this.pendingRobots.has(robot.name)
      )
        continue;
      const robots = reportOf(robot.phase).gone ? lost : here;
      const place = this.subnets.behind.get(robot.place) ?? robot.place;
      if (!robots.has(place)) robots.set(place, []);
      robots.get(place).push(robot);
    }
    return { here, lost };
  }

  flash(t) {
    const { element } = this.transitions[t];
    element.classList.add("flash");
    clearTimeout(element.flashTimer);
    element.flashTimer = setTimeout(() => element.classList.remove("flash"), FLASH);
  }

  setShowEnabled(on) {
    this.container.classList.toggle("no-enabled", !on);
  }

  /** `marks`: name of a node -> what paintNode shows; null clears all highlighting. */
  paint(marks) {
    for (const node of this.nodes) paintNode(node, marks?.get(node.name));
    this.labels.later();
  }

  // -- selecting, moving ---------------------------------------------------------------------------

  nodeOf({ kind, index }) {
    return kind === "place" ? this.places[index] : this.transitions[index];
  }

  select(selection) {
    if (this.selection) this.nodeOf(this.selection).element.classList.remove("selected");
    this.selection = selection;
    const node = selection && this.nodeOf(selection);
    this.subnets.show(node);
    if (node) node.element.classList.add("selected");
    this.labels.later();
    this.arcs.showNear(node);
  }

  /** Draw the nodes where they are now, subnets as they are folded, and the arcs between them. */
  redraw() {
    this.subnets.apply();
    for (const node of this.nodes) settle(node);
    this.route();
  }

  route() {
    this.arcs.route(this.nodes);
    this.subnets.drawBoxes();
  }

  /** Subnets were folded or unfolded. */
  refold() {
    this.redraw();
    if (this.camera.fitted) this.camera.fit();
    this.reset();
    this.labels.later();
  }

  flyTo(kind, index) {
    this.camera.flyTo(this.nodeOf({ kind, index }));
  }

  /** A node is being dragged; its arcs follow with the next frame. */
  moveNode(node, x, y) {
    const [dx, dy] = [x - node.x, y - node.y];
    for (const other of node.folded ? this.nodes.filter((n) => n.folded === node) : [node]) {
      other.home = [other.home[0] + dx, other.home[1] + dy];
      Object.assign(other, { x, y, moved: true });
    }
    follow(node);
    if (!this.routing)
      this.routing = requestAnimationFrame(() => {
        this.routing = 0;
        this.route();
      });
  }

  /** A node was released. */
  dropNode(node) {
    settle(node);
    this.route();
    this.kept.write(this.nodes);
    this.labels.later();
  }

  /** Use another layout from the server, and discard the dragged positions. */
  relayout(layout) {
    this.kept.forget();
    this.put(layout);
    this.arcs.bend(layout.bends);
    this.redraw();
    this.camera.fit();
    this.labels.later();
  }

  close() {
    this.camera.close();
    this.labels.close();
    this.travel.clear();
    cancelAnimationFrame(this.frame);
    this.frame = -1;
    this.container.replaceChildren();
  }
}
