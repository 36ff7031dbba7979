// Tokens that travel when a transition fires: from its input places to it, and then to its output places. A place shows
// a token only once it arrives. If too many tokens are moving, the transition only flashes.

import { s } from "./dom.js";
import { colourOf } from "./colours.js";
import { lengths } from "./geometry.js";

const IN_FLIGHT = 30;
const MILLISECONDS = 420;

export class Travel {
  constructor(view) {
    this.view = view;
    this.inFlight = new Set();
    this.waiting = [];
    this.reduced = matchMedia("(prefers-reduced-motion: reduce)");
    const { scene } = view;
    this.inputs = scene.transitions.map(() => []);
    this.outputs = scene.transitions.map(() => []);
    this.arcs = new Map(); // node -> node at the other end -> arc
    scene.arcs.forEach(([p, t, forth, weight, inhibitor], i) => {
      if (inhibitor) return;
      (forth ? this.inputs : this.outputs)[t].push([p, weight]);
      const arc = view.arcs.all[i];
      if (!this.arcs.has(arc.from)) this.arcs.set(arc.from, new Map());
      this.arcs.get(arc.from).set(arc.to, arc);
    });
  }

  /** The tokens that a firing moves, [from, to, robot]; from or to may be null. */
  flights(event) {
    const flights = event.m.map(([robot, from, to]) => [from, to, robot]);
    const busyIn = new Map(),
      busyOut = new Map();
    for (const [from, to] of flights) {
      if (from !== null) busyIn.set(from, (busyIn.get(from) || 0) + 1);
      if (to !== null) busyOut.set(to, (busyOut.get(to) || 0) + 1);
    }
    const left = (arcs, busy) =>
      arcs.flatMap(([p, weight]) =>
        Array(Math.max(0, Math.min(weight, 4) - (busy.get(p) || 0))).fill(p),
      );
    const sources = left(this.inputs[event.tr], busyIn),
      targets = left(this.outputs[event.tr], busyOut);
    for (let i = 0; i < Math.max(sources.length, targets.length); i++) {
      flights.push([sources[i] ?? null, targets[i] ?? null, null]);
    }
    return flights;
  }

  fired(event) {
    const { view } = this;
    const node = view.transitions[event.tr];
    const flights = this.flights(event);
    if (
      this.reduced.matches ||
      document.hidden ||
      node.out ||
      view.camera.small ||
      this.inFlight.size + this.waiting.length + flights.length > IN_FLIGHT
    ) {
      if (!node.out) view.flash(event.tr);
      return;
    }
    for (const [from, to, robot] of flights) {
      if (to !== null) {
        view.pending.set(to, (view.pending.get(to) || 0) + 1);
        view.dirty.places.add(to);
      }
      if (robot) view.pendingRobots.set(robot, (view.pendingRobots.get(robot) || 0) + 1);
      this.waiting.push({ from, to, robot, node, t: event.tr });
    }
  }

  /** The way between two nodes, along their arc if there is one, as keyframes from the part `begin` to `end` of a
   * motion. */
  leg(from, to, begin, end) {
    const points = this.arcs.get(from)?.get(to)?.shape.points || [];
    const way = [[from.x, from.y], ...points, [to.x, to.y]];
    const far = lengths(way);
    return way.map(([x, y], i) => ({
      transform: `translate(${x}px, ${y}px)`,
      offset: begin + ((end - begin) * far[i]) / (far.at(-1) || 1),
    }));
  }

  /** Start the tokens of the firings since the last frame. */
  begin() {
    if (!this.waiting.length) return;
    const { view } = this;
    for (const flight of this.waiting) {
      const { from, to, robot, node } = flight;
      const [source, target] = [from, to].map((p) => (p === null ? null : view.places[p]));
      const half = source && target ? 0.5 : 1; // the part of the motion that is one arc
      const dot = s("circle", { r: robot ? 8 : 5 });
      if (robot) dot.style.fill = colourOf(robot);
      view.layer.travel.append(dot);
      const frames = [
        ...(source ? this.leg(source, node, 0, half) : []),
        ...(target ? this.leg(node, target, 1 - half, 1) : []),
      ];
      const motion = dot.animate(frames, {
        duration: half < 1 ? MILLISECONDS : MILLISECONDS / 2,
        easing: "ease-in-out",
        fill: "both",
      });
      flight.dot = dot;
      flight.motion = motion;
      this.inFlight.add(flight);
      motion.onfinish = () => this.land(flight);
      view.flash(flight.t);
    }
    this.waiting = [];
  }

  land(flight) {
    const { view } = this;
    if (!this.inFlight.delete(flight)) return;
    flight.dot.remove();
    this.arrive(flight);
    view.request();
  }

  arrive({ from, to, robot }) {
    const { view } = this;
    if (to !== null) {
      const left = (view.pending.get(to) || 0) - 1;
      if (left > 0) view.pending.set(to, left);
      else view.pending.delete(to);
      view.dirty.places.add(to);
    }
    if (robot) {
      const under = (view.pendingRobots.get(robot) || 0) - 1;
      if (under > 0) view.pendingRobots.set(robot, under);
      else view.pendingRobots.delete(robot);
      const now = view.model.board.robots.get(robot);
      if (now && now.place >= 0) view.dirty.places.add(now.place);
    }
    if (from !== null) view.dirty.places.add(from);
  }

  clear() {
    for (const flight of this.inFlight) {
      flight.motion.onfinish = null;
      flight.motion.cancel();
      flight.dot.remove();
    }
    this.inFlight.clear();
    this.waiting = [];
  }
}
