// Gestures on the drawing: selecting, moving, bending, the rubber band, and drawing arcs from the handles of a node. A
// gesture changes the document once, when it ends; until then, only the drawing changes.

import { s } from "../dom.js";
import { bendsOf } from "../arc_routes.js";
import { RADIUS, BAR, distance } from "../geometry.js";
import { AGAIN, Pointer, STILL } from "../net_pointer.js";
import { at } from "../net_nodes.js";
import { snapped } from "./arrange.js";
import { problemOfArc } from "./net_edits.js";

const HANDLE = 36; // px from the centre of a node to its handles
const REACH = 58; // the handles of a node stay while the pointer is this close (px)
const RIM = 3; // px inside the outline of a node where its rim begins, from which arcs are drawn
const GRIP = 7; // px from the middle line of a bar within which a drag moves it
const ARC = 7; // px from the pointer within which an arc is hit
const BEND = 9; // px from the pointer within which a bend is hit
const SIDES = [
  [1, 0],
  [0, 1],
  [-1, 0],
  [0, -1],
];

export class CanvasPointer extends Pointer {
  constructor(mode) {
    super(mode.canvas);
    this.mode = mode;
    this.here = null; // position of the pointer, while it is over the drawing
    this.layer = this.view.layer.over;
    this.handles = s("g.handles");
    this.band = s("rect.band", { visibility: "hidden" });
    this.ghost = s("g.ghost");
    this.guides = s("g.guides");
    this.bends = s("g.bends");
    this.layer.append(this.guides, this.band, this.ghost, this.bends, this.handles);
    this.handled = null; // the node whose handles are shown
    this.entered = undefined; // the group whose nodes are selected one by one, after a double click
    const { container } = this.view;
    container.onpointerleave = () => {
      this.here = null;
      if (!this.gesture) this.showHandles(null);
    };
    this.view.addEventListener("frame", () => {
      this.followHandles();
      this.showBends();
    });
  }

  // -- hit testing -------------------------------------------------------------------------------

  drawing(event) {
    return this.view.toDrawing(...this.point(event));
  }

  /** The node at a point of the drawing; it counts as `slack` px larger than drawn. */
  nodeAt([x, y], slack = 4) {
    let [best, least] = [null, Infinity];
    for (const node of this.view.nodes) {
      const [dx, dy] = [Math.abs(node.x - x), Math.abs(node.y - y)];
      const [w, h] = node.type === "place" ? [RADIUS, RADIUS] : BAR[node.kind];
      if (dx > w + slack + 6 || dy > h + slack) continue;
      const apart = Math.hypot(dx, dy);
      if (apart < least) [best, least] = [node, apart];
    }
    return best;
  }

  /** Whether a point at a node is on its rim, from which a drag draws an arc; inside it, a drag moves the node. */
  onRim(node, [x, y]) {
    const [dx, dy] = [Math.abs(node.x - x), Math.abs(node.y - y)];
    if (node.type === "place") return Math.hypot(dx, dy) > RADIUS - RIM;
    return dx > GRIP || dy > BAR[node.kind][1] - RIM;
  }

  arcAt(point) {
    const { arc: chosen } = this.view;
    if (chosen && this.bendAt(chosen, point) >= 0) return chosen;
    let [best, least] = [null, ARC / this.view.camera.now.k];
    for (const arc of this.view.arcs.all)
      for (let i = 1; i < arc.shape.points.length; i++) {
        const apart = distance(point, arc.shape.points[i - 1], arc.shape.points[i]);
        if (apart < least) [best, least] = [arc, apart];
      }
    return best;
  }

  /** The bend of an arc at a point, by its number; -1: none. */
  bendAt(arc, [x, y]) {
    const reach = BEND / this.view.camera.now.k;
    return bendsOf(arc).findIndex(([bx, by]) => Math.hypot(bx - x, by - y) < reach);
  }

  // -- handles -------------------------------------------------------------------------------------

  /** Show the bends of the selected arc. */
  showBends() {
    const { arc } = this.view;
    const points = arc ? bendsOf(arc) : [];
    const chosen = arc ? this.view.bendChosen(arc) : null;
    this.bends.replaceChildren(
      ...points.map(([cx, cy], i) => s("circle", { cx, cy, r: i === chosen ? 6 : 4 })),
    );
  }

  showHandles(node) {
    if (node === this.handled) return;
    this.handled = node;
    this.handles.replaceChildren(
      ...(node
        ? SIDES.map(([x, y], i) =>
            s(
              "g.handle",
              {
                "data-handle": i,
                transform: at({ x: x * HANDLE, y: y * HANDLE }),
              },
              s("circle", { r: 8.5 }),
              s("path", { d: "M-4 0h8M0 -4v8" }),
            ),
          )
        : []),
    );
    this.followHandles();
  }

  followHandles() {
    if (this.handled && !this.view.byKey.has(this.handled.key)) this.showHandles(null);
    if (this.handled) this.handles.setAttribute("transform", at(this.handled));
  }

  hover(event) {
    if (event.pointerType === "touch" || this.mode.tool) return;
    const point = this.drawing(event);
    const { handled } = this;
    const over = this.nodeAt(point);
    this.view.container.classList.toggle("on-rim", Boolean(over && this.onRim(over, point)));
    if (over) this.showHandles(over);
    else if (handled && Math.hypot(handled.x - point[0], handled.y - point[1]) > REACH)
      this.showHandles(null);
  }

  // -- gestures ------------------------------------------------------------------------------------

  down(event) {
    if (event.button !== 0 && event.button !== 1) return;
    const { view, mode } = this;
    view.camera.stop();
    mode.endRename(true);
    view.container.focus({ preventScroll: true });
    const point = this.drawing(event);
    const handle = event.target.closest("[data-handle]");
    const node = handle ? this.handled : this.nodeAt(point);
    const arc = node ? null : this.arcAt(point);
    const group = node ? view.groupOf(node) : arc ? undefined : view.groupAt(point);
    // a finger moves what a tap has selected; otherwise, the view
    const touches = event.pointerType === "touch" && !(node && mode.selection.has(node.key));
    const looks = event.button === 1 || mode.panning || touches;
    const kind = looks
      ? "pan"
      : handle || (mode.tool === "arc" && node) || this.drawsFrom(event, node, point)
        ? "arc"
        : node
          ? "move"
          : mode.tool && mode.tool !== "arc"
            ? "place"
            : arc && !mode.tool && !event.shiftKey
              ? "bend"
              : group !== undefined && !mode.tool && !event.shiftKey
                ? "move"
                : "band";
    this.gesture = {
      kind,
      node,
      arc,
      group,
      at: this.point(event),
      from: point,
      camera: { ...view.camera.now },
      moved: false,
    };
    view.container.setPointerCapture(event.pointerId);
    event.preventDefault();
  }

  /** Whether a drag from here draws an arc although neither a handle nor a tool is active. */
  drawsFrom(event, node, point) {
    const plain = !this.mode.tool && !event.shiftKey && event.pointerType !== "touch";
    return node && plain && this.onRim(node, point);
  }

  move(event) {
    this.here = this.drawing(event);
    const { gesture, view } = this;
    if (!gesture) {
      this.hover(event);
      return;
    }
    const [x, y] = this.point(event);
    const [dx, dy] = [x - gesture.at[0], y - gesture.at[1]];
    if (!gesture.moved && Math.hypot(dx, dy) < STILL) return;
    if (!gesture.moved) {
      gesture.moved = true;
      view.container.classList.toggle("dragging", gesture.kind === "pan");
      if (gesture.kind === "move") this.take(event);
      if (gesture.kind === "bend") this.takeBend();
      if (gesture.kind !== "pan") this.showHandles(null);
    }
    if (gesture.kind === "pan") this.pan(gesture.camera, dx, dy);
    else if (gesture.kind === "move") this.drag();
    else if (gesture.kind === "arc") this.draw();
    else if (gesture.kind === "bend") this.bend();
    else if (gesture.kind === "band") this.stretch();
  }

  /** Begin to move the selected nodes, or the one under the pointer. */
  take(event) {
    const { mode, gesture } = this;
    const keys = this.meant(gesture);
    if (!keys.every((key) => mode.selection.has(key)))
      mode.choose(event.shiftKey ? [...mode.selection, ...keys] : keys);
    gesture.nodes = mode.actions.chosenNodes();
    gesture.starts = gesture.nodes.map(({ x, y }) => [x, y]);
    const moving = new Set(gesture.nodes);
    gesture.others = this.view.nodes.filter((node) => !moving.has(node));
    const { x, y } = gesture.node ?? gesture.nodes[0];
    gesture.home = [x, y];
  }

  /** The keys of the nodes that a click or a drag is about: a node, or all of the group that it is in, or whose box was
   * hit. */
  meant({ node, group }) {
    return group !== undefined && !(node && group === this.entered)
      ? this.view.keysOf(`group:${group}`)
      : [node.key];
  }

  drag() {
    const { gesture, view, here } = this;
    const [x0, y0] = gesture.home;
    const { k } = view.camera.now;
    const { x, y, guides } = snapped(
      x0 + here[0] - gesture.from[0],
      y0 + here[1] - gesture.from[1],
      gesture.others,
      k,
    );
    view.lift(gesture.nodes);
    gesture.nodes.forEach((node, i) => {
      const [sx, sy] = gesture.starts[i];
      view.moveTo(node, sx + x - x0, sy + y - y0);
    });
    this.showGuides(guides);
  }

  /** Begin to move a bend: the one under the pointer, or a new one. */
  takeBend() {
    const { mode, gesture, view } = this;
    const { arc, from } = gesture;
    mode.choose([arc.key]);
    gesture.bends = bendsOf(arc);
    gesture.bend = this.bendAt(arc, from);
    if (gesture.bend < 0) {
      gesture.bend = view.segmentAt(arc, from);
      gesture.bends.splice(gesture.bend, 0, from);
    }
    view.chooseBend(arc, gesture.bend);
    view.lift([arc.from, arc.to]);
  }

  bend() {
    const { gesture, view, here } = this;
    const { x, y, guides } = snapped(here[0], here[1], view.nodes, view.camera.now.k);
    gesture.bends[gesture.bend] = [x, y];
    view.bend(gesture.arc, gesture.bends);
    this.showGuides(guides);
  }

  showGuides(guides) {
    const { view } = this;
    const { width, height } = view.container.getBoundingClientRect();
    const [x0, y0] = view.toDrawing(0, 0);
    const [x1, y1] = view.toDrawing(width, height);
    this.guides.replaceChildren(
      ...guides.map(([axis, value]) =>
        s("path", {
          d: axis === "x" ? `M${value} ${y0}V${y1}` : `M${x0} ${value}H${x1}`,
        }),
      ),
    );
  }

  /** Where the arc being drawn would end: {node, x, y, problem}. */
  target() {
    const { gesture, view, here, mode } = this;
    const node = this.nodeAt(here, 10);
    if (node && node !== gesture.node) {
      const problem = problemOfArc(mode.document.net, gesture.node.key, node.key);
      return { node, x: node.x, y: node.y, problem };
    }
    const { x, y } = snapped(here[0], here[1], view.nodes, view.camera.now.k);
    return { node: null, x, y, problem: "" };
  }

  draw() {
    const { gesture, mode } = this;
    const { node, x, y, problem } = this.target();
    const what = mode.actions.kindAfter(gesture.node.key);
    const [w, h] = BAR[what] || [0, 0];
    const parts = [s("path", { d: `M${gesture.node.x} ${gesture.node.y}L${x} ${y}` })];
    if (!node)
      parts.push(
        what === "place"
          ? s("circle", { cx: x, cy: y, r: RADIUS })
          : s("rect", { x: x - w, y: y - h, width: 2 * w, height: 2 * h }),
      );
    else parts.push(s("circle.goal", { cx: x, cy: y, r: RADIUS + 7 }));
    if (problem) parts.push(s("text", { x, y: y - RADIUS - 14, text: problem }));
    this.ghost.setAttribute("class", problem ? "ghost wrong" : "ghost");
    this.ghost.replaceChildren(...parts);
  }

  stretch() {
    const { gesture, here, view } = this;
    const [x0, y0] = gesture.from;
    const box = [
      Math.min(x0, here[0]),
      Math.min(y0, here[1]),
      Math.max(x0, here[0]),
      Math.max(y0, here[1]),
    ];
    for (const [name, value] of Object.entries({
      x: box[0],
      y: box[1],
      width: box[2] - box[0],
      height: box[3] - box[1],
      visibility: "visible",
    }))
      this.band.setAttribute(name, value);
    gesture.inside = view.nodes.filter(
      (node) => node.x >= box[0] && node.x <= box[2] && node.y >= box[1] && node.y <= box[3],
    );
  }

  clear() {
    this.gesture = null;
    this.view.container.classList.remove("dragging");
    this.band.setAttribute("visibility", "hidden");
    this.ghost.replaceChildren();
    this.guides.replaceChildren();
  }

  /** End a gesture without an edit: draw everything at its position in the document. */
  cancel() {
    for (const node of this.gesture?.nodes || []) this.view.place(node);
    if (this.gesture?.bends) this.view.bend(this.gesture.arc);
    this.clear();
  }

  up(event) {
    const { gesture, mode } = this;
    if (!gesture) return;
    if (event.type !== "pointerup") {
      this.cancel();
      return;
    }
    this.move(event);
    const end = gesture.kind === "arc" && gesture.moved ? this.target() : null;
    this.clear();
    if (!gesture.moved) this.click(event, gesture);
    else if (gesture.kind === "move") {
      const points = new Map(gesture.nodes.map(({ name, x, y }) => [name, [x, y]]));
      mode.actions.move(`Move ${mode.actions.listed(gesture.nodes.map(({ key }) => key))}`, points);
    } else if (gesture.kind === "arc") this.join(event, gesture.node, end);
    else if (gesture.kind === "bend") mode.actions.bend(gesture.arc, gesture.bends);
    else if (gesture.kind === "band") {
      const keys = (gesture.inside || []).map(({ key }) => key);
      mode.choose(event.shiftKey ? [...mode.selection, ...keys] : keys);
    }
  }

  join(event, from, { node, x, y, problem }) {
    const { mode } = this;
    let added = null;
    if (problem) mode.say(problem);
    else if (node) mode.actions.connect(from.key, node.key);
    else added = mode.actions.add(mode.actions.kindAfter(from.key), x, y, from.key);
    mode.setTool(null);
    this.name(event, added);
  }

  /** Ask for the name of a node just added: the next keys typed become its name. (Not after a touch, which would open
   * the on-screen keyboard.) */
  name(event, key) {
    if (key && event.pointerType !== "touch") this.mode.beginRename(key);
  }

  click(event, gesture) {
    const { kind, node, arc, group, from } = gesture;
    const { mode, view } = this;
    if (kind === "place") {
      const { x, y } = snapped(from[0], from[1], view.nodes, view.camera.now.k);
      const added = mode.actions.add(mode.tool, x, y);
      if (!event.shiftKey) mode.setTool(null);
      this.name(event, added);
      return;
    }
    if (mode.tool === "arc") {
      if (node) mode.arcTo(node.key);
      return;
    }
    const key = node?.key || arc?.key || (group === undefined ? undefined : `group:${group}`);
    const now = performance.now();
    const again = this.lastClick && now - this.lastClick.at < AGAIN && this.lastClick.key === key;
    this.lastClick = { at: now, key };
    if (again) {
      this.lastClick = null;
      if (node && group !== this.entered) {
        this.entered = group;
        mode.choose([key]);
      } else this.twice(event, key, from, arc);
    } else {
      if (!node || group !== this.entered) this.entered = undefined;
      const keys = arc ? [key] : key ? this.meant(gesture) : [];
      if (event.shiftKey && key) {
        const all = keys.every((it) => mode.selection.has(it));
        const others = [...mode.selection].filter((it) => !keys.includes(it));
        mode.choose(all ? others : [...others, ...keys]);
      } else if (key || !event.shiftKey) mode.choose(keys);
    }
    if (node && event.pointerType !== "touch") this.showHandles(node);
  }

  twice(event, key, [x, y], arc) {
    const { mode, view } = this;
    const bend = arc ? this.bendAt(arc, [x, y]) : -1;
    if (bend >= 0) {
      mode.actions.removeBend(arc, bend);
      return;
    }
    if (key) {
      if (!mode.actions.openSubnet(key)) mode.beginRename(key);
      return;
    }
    if (event.pointerType === "touch") return; // touch does not edit
    const spot = snapped(x, y, view.nodes, view.camera.now.k);
    const what = event.shiftKey ? "timed" : event.altKey ? "immediate" : "place";
    this.name(event, mode.actions.add(what, spot.x, spot.y));
  }
}
