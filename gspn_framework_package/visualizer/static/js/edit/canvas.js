// The drawing of the document that is being edited. Two states of a document share everything unchanged, so only the
// elements of changed objects are redrawn: an edit costs the same in a large net as in a small one.

import { s } from "../dom.js";
import { ArcRoutes, bendsOf, boundsOf } from "../arc_routes.js";
import { arcLine, arcEnd, distance } from "../geometry.js";
import { Camera } from "../net_camera.js";
import { Labels } from "../labels.js";
import {
  boxOf,
  boxesAround,
  buildPlace,
  buildTransition,
  drawPlace,
  follow,
  put,
  settle,
} from "../net_nodes.js";
import { sizeAt } from "../net_arcs.js";
import { arcKey, groupsIn, nodeKey } from "./net_edits.js";

const GAP = 96; // px between the nodes of a net without positions
const FEW = 60; // an edit that changes up to this many nodes has them drawn in the upper sheet
const MOST_LIFTED = 300; // with more nodes in the upper sheet, all go back
const QUIET = 600; // ms without a change after which they go back
const LEVELS = ["error", "warning", "note"]; // of marks

/** Fires "frame" after drawing. Elements have the same keys as in the selection: "place:NAME", "arc:FROM>TO". */
export class Canvas extends EventTarget {
  /** `scale`: the factor by which the document's positions are spread so that no symbols overlap. */
  constructor(container, document, scale) {
    super();
    this.container = container;
    this.document = document;
    this.byKey = new Map(); // key -> node
    this.arcsByKey = new Map(); // key -> arcs between the same nodes
    this.nodes = [];
    this.arcs = { all: [], zoomed: (k) => this.zoomed(k) };
    this.chosen = new Set();
    this.marks = new Map();
    this.routes = new ArcRoutes();
    this.moved = false; // whether arcs are to be routed before the next frame
    this.size = 1;
    this.own = new Map(); // positions of nodes that have none in the document
    this.shown = null; // the state that is drawn
    this.loose = false; // whether an arc lacks a node
    this.bent = null; // the bend that keys move: {key of the arc, index}
    this.counts = null; // tokens shown instead of the document's
    const sheet = (name, ...content) =>
      s("svg", { class: name, "aria-hidden": "true" }, ...content);
    this.groups = new Map(); // title -> the nodes that are drawn in one box
    this.layer = {
      boxes: s("g.boxes"),
      arcs: s("g"),
      nodes: s("g"),
      liftedArcs: s("g.arcs"),
      liftedNodes: s("g"),
      over: s("g"),
    };
    this.lifted = new Set(); // nodes in the upper sheet
    this.quiet = 0; // timer until they go back
    container.replaceChildren(
      sheet("arcs", this.layer.boxes, this.layer.arcs),
      sheet("nodes", this.layer.nodes),
      sheet("nodes", this.layer.liftedArcs, this.layer.liftedNodes),
      sheet("over", this.layer.over),
    );
    this.moving = Object.values(this.layer);
    this.scale = scale;
    this.putOnGrid();
    this.show();
    this.labels = new Labels(this);
    this.camera = new Camera(this);
    this.changed = () => {
      this.camera.fitted = false; // an element that is being edited stays where it is
      this.show();
    };
    document.addEventListener("change", this.changed);
  }

  // -- positions -----------------------------------------------------------------------------------

  /** Put the nodes without positions on a grid below the others. */
  putOnGrid() {
    const { places, transitions } = this.document.net;
    const nodes = [...places, ...transitions];
    const bare = nodes.filter((node) => !node.position);
    const across = Math.ceil(Math.sqrt(bare.length * 1.6)) || 1;
    const below = Math.max(
      -GAP,
      ...nodes.filter((n) => n.position).map((n) => n.position[1] * this.scale),
    );
    bare.forEach((node, i) =>
      this.own.set(node.name, [(i % across) * GAP, below + GAP * (1 + Math.floor(i / across))]),
    );
  }

  /** The position of a node of the document, in pixels of the drawing. */
  positionOf(data) {
    if (data.position) return data.position.map((value) => value * this.scale);
    if (!this.own.has(data.name)) this.own.set(data.name, this.freeSpot());
    return this.own.get(data.name);
  }

  /** Convert a position from the drawing to the document. */
  toDocument(x, y) {
    return [x, y].map((value) => Math.round((value / this.scale) * 100) / 100 + 0);
  }

  /** The positions of all nodes in the document's units: name -> [x, y]. */
  positions() {
    return new Map(this.nodes.map((node) => [node.name, this.toDocument(node.x, node.y)]));
  }

  /** Show nodes that have no position where the server's layout puts them; the document is not changed. */
  useLayout({ places, transitions }) {
    for (const [name, [x, y]] of Object.entries({ ...places, ...transitions }))
      this.own.set(name, [x, y]);
    for (const node of this.nodes) if (!node.data.position) this.place(node);
    this.camera.fit();
  }

  /** A spot without nodes, near [x, y] or the middle of the view. */
  freeSpot(x, y) {
    if (x === undefined) {
      const { width, height } = this.container.getBoundingClientRect();
      const { k, x: x0, y: y0 } = this.camera?.now || { k: 1, x: 0, y: 0 };
      [x, y] = [(width / 2 - x0) / k, (height / 2 - y0) / k];
    }
    const taken = (px, py) =>
      this.nodes.some((node) => Math.abs(node.x - px) < 50 && Math.abs(node.y - py) < 50);
    for (let ring = 0; ring < 40; ring++)
      for (const [dx, dy] of [0, 1, -1].flatMap((i) => [0, 1, -1].map((j) => [i, j]))) {
        const [px, py] = [x + dx * ring * 70, y + dy * ring * 70].map(
          (v) => Math.round(v / 10) * 10,
        );
        if (!taken(px, py)) return [px, py];
      }
    return [x, y];
  }

  /** Convert a point from the container to the drawing. */
  toDrawing(px, py) {
    const { k, x, y } = this.camera.now;
    return [(px - x) / k, (py - y) / k];
  }

  bounds() {
    return boundsOf(this.nodes, this.arcs.all, 40, this.groups.size ? 60 : 40) || [0, 0, 480, 320];
  }

  // -- drawing what changed ------------------------------------------------------------------------

  /** Draw the present state by redrawing what differs from the state already drawn. */
  show() {
    const { state } = this.document;
    const before = this.shown;
    const { net, plan } = state;
    this.shown = state;
    const another = (key) => !before || before.net[key] !== net[key];
    const roles = !before || before.plan !== plan;
    if (roles) {
      this.resources = new Set(Array.isArray(plan?.resource_places) ? plan.resource_places : []);
      this.actions = plan?.actions || {};
    }
    let nodes = false;
    if (another("places") || roles) nodes = this.showNodes("place", net.places) || nodes;
    if (another("transitions")) nodes = this.showNodes("transition", net.transitions) || nodes;
    if (nodes) this.nodes = [...this.byKey.values()];
    if (nodes || roles) this.groups = this.groupsOf(plan);
    if (another("arcs") || this.loose) this.showArcs(net.arcs);
    this.labels?.later();
    this.moved = true;
    this.request();
  }

  nodeNamed(name) {
    return this.byKey.get(nodeKey("place", name)) || this.byKey.get(nodeKey("transition", name));
  }

  /** The nodes of each group of a plan that may be unfinished: title -> nodes. */
  groupsOf(plan) {
    return new Map(
      Object.entries(groupsIn(plan))
        .map(([title, names]) => [title, names.map((name) => this.nodeNamed(name)).filter(Boolean)])
        .filter(([, nodes]) => nodes.length),
    );
  }

  /** The title of the group in which a node is; undefined: none. */
  groupOf(node) {
    return [...this.groups].find(([, nodes]) => nodes.includes(node))?.[0];
  }

  /** The title of the group whose box is at a point of the drawing; undefined: none. */
  groupAt([x, y]) {
    const found = [...this.groups].find(([title, nodes]) => {
      const [left, top, right, bottom] = boxOf(nodes, title);
      return left < x && x < right && top < y && y < bottom;
    });
    return found?.[0];
  }

  /** The keys of the nodes of "group:TITLE"; for any other key, the key itself. */
  keysOf(key) {
    const nodes = key.startsWith("group:") && this.groups.get(key.slice("group:".length));
    return nodes ? nodes.map((node) => node.key) : [key];
  }

  /** The title of the selected group, if the selection is exactly one group; else undefined. */
  get group() {
    const nodes = [...this.chosen].filter((key) => this.byKey.has(key));
    const all = (title) => {
      const keys = this.keysOf(`group:${title}`);
      return keys.length === nodes.length && keys.every((key) => this.chosen.has(key));
    };
    return nodes.length ? [...this.groups.keys()].find(all) : undefined;
  }

  drawBoxes() {
    const chosen = this.group;
    this.layer.boxes.replaceChildren(...boxesAround(this.groups));
    for (const box of this.layer.boxes.children)
      box.classList.toggle("selected", box.dataset.box === chosen);
  }

  classOf(kind, data) {
    if (kind === "transition") return data.timed ? "timed" : "immediate";
    if (this.subnetOf(data.name)) return "subnet-box";
    return this.resources.has(data.name) ? "resource" : "";
  }

  /** The file of the subnet that a place stands for, or null. */
  subnetOf(place) {
    const action = Object.hasOwn(this.actions, place) ? this.actions[place] : null;
    return typeof action?.plan === "string" ? action.plan : null;
  }

  /** Returns whether nodes were added or removed. */
  showNodes(kind, list) {
    const seen = new Set();
    const touched = [];
    let other = false;
    for (const data of list) {
      const key = nodeKey(kind, data.name);
      seen.add(key);
      const node = this.byKey.get(key);
      const look = this.classOf(kind, data);
      if (!node) {
        touched.push(this.add(kind, key, data, look));
        other = true;
      } else if (node.data !== data || node.look !== look) {
        const moved = node.data.position !== data.position;
        node.data = data;
        if (node.look !== look) this.rebuild(node, look);
        if (moved) this.place(node);
        this.drawTokens(node);
        touched.push(node);
      }
    }
    if (touched.length <= FEW) this.lift(touched);
    else touched.forEach(settle);
    for (const [key, node] of this.byKey) {
      if (node.type !== kind || seen.has(key)) continue;
      node.element.remove();
      this.byKey.delete(key);
      this.lifted.delete(node);
      this.loose = this.loose || node.arcs.size > 0;
      other = true;
    }
    return other;
  }

  add(kind, key, data, look) {
    const node = { type: kind, key, name: data.name, data, arcs: new Set() };
    [node.x, node.y] = this.positionOf(data);
    this.byKey.set(key, node);
    this.build(node, look);
    this.layer.nodes.append(node.element);
    return node;
  }

  build(node, look) {
    node.look = look;
    node.kind = node.type === "place" ? "place" : look;
    node.index = node.name;
    if (node.type === "place") buildPlace(node, { name: node.name, kind: look });
    else buildTransition(node, { name: node.name });
    Object.assign(node, { count: undefined, dots: null, label: null, value: null, sign: null });
    node.element.classList.toggle("selected", this.chosen.has(node.key));
    this.drawTokens(node);
    this.drawMark(node);
  }

  rebuild(node, look) {
    const old = node.element;
    this.build(node, look);
    old.replaceWith(node.element);
    for (const arc of node.arcs) arc.stale = true;
    this.moved = true;
  }

  drawTokens(node) {
    if (node.type !== "place") return;
    const shown = this.counts?.get(node.name);
    drawPlace(node, shown ?? node.data.tokens ?? 0, []);
  }

  /** Draw a node at its position in the document. */
  place(node) {
    this.moveTo(node, ...this.positionOf(node.data));
    for (const arc of node.arcs) this.bend(arc);
  }

  /** Draw an arc with its bends in the document, or with others (px of the drawing). */
  bend(arc, bends = arc.data.bends?.map((bend) => bend.map((value) => value * this.scale))) {
    if (!bends && !arc.bends) return;
    const ends = [arc.from, arc.to].map(({ data }) => this.positionOf(data));
    const [x, y] = [0, 1].map((axis) => (ends[0][axis] + ends[1][axis]) / 2);
    arc.bends = bends?.length ? bends.map(([bx, by]) => [bx - x, by - y]) : undefined;
    arc.stale = true;
    this.moved = true;
    this.request();
  }

  /** The only selected arc, or undefined. */
  get arc() {
    const [key, more] = this.chosen;
    return more ? undefined : this.arcsByKey.get(key)?.[0];
  }

  /** The bend of an arc that keys move, by its number; null: none. */
  bendChosen(arc) {
    const { length } = arc.bends || [];
    return length && this.bent?.key === arc.key ? Math.min(this.bent.index, length - 1) : null;
  }

  chooseBend({ key }, index) {
    this.bent = { key, index };
    this.request();
  }

  /** The part of an arc, between its ends and bends, that is nearest to a point. */
  segmentAt(arc, point) {
    const { from, to } = arc;
    const stops = [[from.x, from.y], ...bendsOf(arc), [to.x, to.y]];
    const apart = stops.slice(1).map((stop, i) => distance(point, stops[i], stop));
    return apart.indexOf(Math.min(...apart));
  }

  /** Draw a node at another position, without changing the document. */
  moveTo(node, x, y) {
    if (node.x === x && node.y === y) return;
    [node.x, node.y] = [x, y];
    follow(node);
    this.moved = true;
    this.request();
  }

  /** Draw some nodes and their arcs in a separate sheet until nothing has changed for a while, so that changing them
   * does not redraw all others. */
  lift(nodes) {
    if (this.lifted.size > MOST_LIFTED) this.settle();
    for (const node of nodes) {
      if (this.lifted.has(node)) continue;
      this.lifted.add(node);
      for (const { element } of node.arcs) this.layer.liftedArcs.append(element);
      this.layer.liftedNodes.append(node.element);
    }
    this.changedAt = performance.now();
    if (this.lifted.size && !this.quiet) this.settleAfter(QUIET);
  }

  settleAfter(time) {
    this.quiet = setTimeout(() => {
      const left = this.changedAt + QUIET - performance.now();
      if (left > 0) this.settleAfter(left);
      else this.settle();
    }, time);
  }

  /** Put the lifted nodes back. */
  settle() {
    clearTimeout(this.quiet);
    this.quiet = 0;
    this.lifted.forEach(settle);
    this.lifted.clear();
    const { arcs, nodes, liftedArcs, liftedNodes } = this.layer;
    arcs.append(...liftedArcs.children);
    nodes.append(...liftedNodes.children);
  }

  showArcs(list) {
    const known = new Map(this.arcs.all.map((arc) => [arc.data, arc]));
    const both = new Set(list.map((data) => arcKey(data)));
    const all = [];
    this.loose = false;
    for (const data of list) {
      const [from, to] = [data.from, data.to].map((name) => this.nodeNamed(name));
      if (!from || !to) {
        this.loose = true;
        continue;
      }
      const bent = both.has(arcKey({ from: data.to, to: data.from }));
      let arc = known.get(data);
      known.delete(data);
      if (arc && (arc.from !== from || arc.to !== to)) {
        this.dropArc(arc);
        arc = null;
      }
      if (!arc) arc = this.addArc(data, from, to);
      if (arc.both !== bent) Object.assign(arc, { both: bent, stale: true });
      all.push(arc);
    }
    for (const arc of known.values()) this.dropArc(arc);
    this.arcs.all = all;
    this.arcsByKey = new Map();
    for (const arc of all) {
      if (!this.arcsByKey.has(arc.key)) this.arcsByKey.set(arc.key, []);
      this.arcsByKey.get(arc.key).push(arc);
    }
  }

  addArc(data, from, to) {
    const key = arcKey(data);
    const line = s("path", { class: `lines${data.inhibitor ? " inhibitor" : ""}` });
    const end = s("path", { class: data.inhibitor ? "circles" : "heads" });
    const element = s("g.arc", { "data-arc": key }, line, end);
    const shape = { points: [], middle: [0, 0] };
    const arc = { key, data, from, to, both: null, line, end, element, shape, stale: true };
    if ((data.weight ?? 1) !== 1) {
      arc.weight = s("text", String(data.weight));
      element.append(arc.weight);
    }
    element.classList.toggle("selected", this.chosen.has(key));
    this.bend(arc);
    from.arcs.add(arc);
    to.arcs.add(arc);
    const lifted = this.lifted.has(from) || this.lifted.has(to);
    this.layer[lifted ? "liftedArcs" : "arcs"].append(element);
    return arc;
  }

  dropArc(arc) {
    arc.from.arcs.delete(arc);
    arc.to.arcs.delete(arc);
    arc.element.remove();
  }

  /** Draw the arcs between the nodes as they are now. */
  drawArcs() {
    this.moved = false;
    for (const arc of this.routes.route(this.nodes, this.arcs.all)) {
      arc.line.setAttribute("d", arcLine(arc.shape, arc.data.inhibitor));
      this.drawEnd(arc);
      const [x, y] = arc.shape.middle;
      arc.weight?.setAttribute("x", x.toFixed(1));
      arc.weight?.setAttribute("y", y.toFixed(1));
    }
  }

  drawEnd(arc) {
    arc.end.setAttribute("d", arcEnd(arc.shape, arc.data.inhibitor, this.size));
  }

  zoomed(k) {
    if (sizeAt(k) === this.size) return;
    this.size = sizeAt(k);
    for (const arc of this.arcs.all) if (!arc.stale) this.drawEnd(arc);
  }

  request() {
    if (!this.frame) this.frame = requestAnimationFrame(() => this.draw());
  }

  draw() {
    this.frame = 0;
    if (this.camera.dirty) {
      this.camera.draw();
      this.labels.later();
    }
    if (this.moved) {
      this.drawArcs();
      this.drawBoxes();
    }
    this.dispatchEvent(new CustomEvent("frame"));
  }

  // -- selection, marks, tokens --------------------------------------------------------------------

  elementsOf(key) {
    const node = this.byKey.get(key);
    return node ? [node.element] : (this.arcsByKey.get(key) || []).map((arc) => arc.element);
  }

  select(keys) {
    for (const key of this.chosen)
      if (!keys.has(key))
        for (const element of this.elementsOf(key)) element.classList.remove("selected");
    for (const key of keys)
      for (const element of this.elementsOf(key)) element.classList.add("selected");
    this.chosen = new Set(keys);
    this.labels.later();
    this.drawBoxes();
    this.request();
  }

  /** The one node whose name takes precedence, for Labels. */
  get selection() {
    for (const key of this.chosen) if (this.byKey.has(key)) return key;
    return null;
  }

  nodeOf(key) {
    return this.byKey.get(key);
  }

  /** `marks`: key of a node -> {level: "error" | "warning" | "note", text}. */
  mark(marks) {
    this.marks = marks;
    for (const node of this.nodes) this.drawMark(node);
    this.labels.later();
  }

  drawMark(node) {
    const mark = this.marks.get(node.key);
    node.sign?.remove();
    node.sign = null;
    node.element.classList.remove(...LEVELS.map((level) => `mark-${level}`));
    const title = node.element.querySelector("title");
    title.textContent = mark ? `${node.name}: ${mark.text}` : node.name;
    if (!mark) return;
    node.element.classList.add(`mark-${mark.level}`);
    const text = s("text", mark.level === "note" ? "i" : "!");
    node.sign = put(node, s("g.mark-sign", s("circle", { r: 8 }), text), [17, -20]);
  }

  /** Show other tokens than the document's: place -> count; null: those of the document. */
  showTokens(counts) {
    this.counts = counts;
    for (const node of this.nodes) this.drawTokens(node);
  }

  flyTo(key) {
    const node = this.byKey.get(key) || this.arcsByKey.get(key)?.[0].from;
    if (node) this.camera.flyTo(node);
  }

  close() {
    this.document.removeEventListener("change", this.changed);
    clearTimeout(this.quiet);
    this.camera.close();
    this.labels.close();
    cancelAnimationFrame(this.frame);
    this.frame = -1;
    this.container.replaceChildren();
  }
}
