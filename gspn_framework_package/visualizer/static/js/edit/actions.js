// What the user can do to the net by pointer, key or button; each action is one edit of the document.

import { attempt, plural } from "../dom.js";
import { post } from "../api.js";
import { bendsOf } from "../arc_routes.js";
import { GRID, arranged, onGrid } from "./arrange.js";
import { copied, fitted, parsed, partText } from "./clipboard.js";
import { renamed, without, problemOfName } from "./rename.js";
import { planSchema } from "./schema.js";
import {
  changed,
  addParts,
  arcKey,
  changeArcs,
  changeNodes,
  findNode,
  freeName,
  freeTitle,
  moveNodes,
  nodeKey,
  otherKind,
  problemOfArc,
  unbent,
  withGroup,
} from "./net_edits.js";

const FIRST = { place: "P1", timed: "T1", immediate: "t1" };
export const WORDS = {
  place: "place",
  timed: "timed transition",
  immediate: "immediate transition",
};
const NEXT = 100; // px from a node to one that is added after it
const EDGE = 50; // px from the edge of the view to a part that is dropped there

let kept = ""; // the last copy, used where the system's clipboard cannot be read

export class Actions {
  constructor(mode) {
    this.mode = mode;
    this.after = "timed"; // the kind of transition that is added after a place
  }

  get net() {
    return this.mode.document.net;
  }

  /** The selected keys of one kind: "place", "transition" or "arc". */
  chosen(...kinds) {
    return [...this.mode.selection].filter((key) =>
      kinds.some((kind) => key.startsWith(`${kind}:`)),
    );
  }

  edit(label, change, merge = null) {
    this.mode.witness?.end();
    const done = this.mode.document.edit(label, change, merge);
    if (done) this.mode.say(label);
    return done;
  }

  /** Change the net; if any node now has a position, give all of them one. */
  placed(net, positions = new Map()) {
    return moveNodes(net, positions, () => this.mode.canvas.positions());
  }

  // -- adding --------------------------------------------------------------------------------------

  /** A new node of the kind "place", "timed" or "immediate". */
  fresh(what, x, y) {
    const position = this.mode.canvas.toDocument(x, y);
    const name = freeName(this.net, FIRST[what]);
    if (what === "place") return { name, position };
    this.after = what;
    return what === "timed" ? { name, timed: true, rate: 1, position } : { name, position };
  }

  /** Add a node at a point of the drawing, with an arc from the node `from` or to it (`back`). Returns its key. */
  add(what, x, y, from = null, back = false) {
    const { mode } = this;
    const node = this.fresh(what, x, y);
    const place = what === "place";
    const parts = place ? { places: [node] } : { transitions: [node] };
    let label = `Add the ${WORDS[what]} ${node.name}`;
    if (from) {
      const other = findNode(this.net, from);
      if ((other.kind === "place") === place) {
        mode.say(`An arc joins a place and a transition; both of these are ${other.kind}s.`);
        return null;
      }
      const [a, b] = back ? [node.name, other.data.name] : [other.data.name, node.name];
      parts.arcs = [{ from: a, to: b }];
      label = `${label}, with an arc from ${a} to ${b}`;
    }
    this.edit(label, ({ net }) => ({ net: this.placed(addParts(net, parts)) }));
    const key = nodeKey(place ? "place" : "transition", node.name);
    mode.choose([key]);
    return key;
  }

  /** The kind of node that usually follows this one. */
  kindAfter(key) {
    return key.startsWith("place:") ? this.after : "place";
  }

  /** Add a node by key: at the pointer, after the selected node (`joined`: with an arc), or in the middle. */
  addHere(what, joined = false) {
    const { canvas, selection } = this.mode;
    const from = [...selection].find((key) => canvas.byKey.has(key));
    if (joined && !from) {
      this.mode.say("Select the node that the arc comes from.");
      return;
    }
    const at = canvas.byKey.get(from);
    const pointer = !joined && this.mode.pointer.here;
    const [x, y] = pointer || (at ? canvas.freeSpot(at.x + NEXT, at.y) : canvas.freeSpot());
    const spot = pointer ? canvas.freeSpot(...pointer) : [x, y];
    const key = this.add(what, ...spot, joined ? from : null);
    if (!key) return;
    canvas.flyTo(key);
    this.mode.added = { key, state: this.mode.document.state };
  }

  /** Make an arc between two nodes, or say why it is not possible. */
  connect(from, to) {
    const problem = problemOfArc(this.net, from, to);
    if (problem) {
      this.mode.say(problem);
      return false;
    }
    const arc = { from: findNode(this.net, from).data.name, to: findNode(this.net, to).data.name };
    this.edit(`Add an arc from ${arc.from} to ${arc.to}`, ({ net }) => ({
      net: addParts(net, { arcs: [arc] }),
    }));
    this.mode.choose([arcKey(arc)]);
    return true;
  }

  // -- changing ------------------------------------------------------------------------------------

  remove() {
    const { mode } = this;
    const keys = [...mode.selection];
    if (!keys.length) return;
    const { state, said } = without(mode.document.state, keys);
    const text = `Delete ${this.listed(keys)}`;
    this.edit(text, () => state);
    if (said.length) mode.say(`${text}; also removed: ${said.join(", ")}.`);
    mode.choose([]);
  }

  listed(keys) {
    return keys.length === 1
      ? keys[0].slice(keys[0].indexOf(":") + 1).replace(">", " → ")
      : plural(keys.length, "element");
  }

  /** Add tokens to the selected places, and weight to the selected arcs. Returns whether any are selected. */
  count(by) {
    const places = this.chosen("place");
    const arcs = this.chosen("arc");
    if (!places.length && !arcs.length) return false;
    const keys = [...places, ...arcs];
    const what = places.length ? (arcs.length ? "Tokens and weights" : "Tokens") : "Weight";
    this.edit(
      `${what} of ${this.listed(keys)} ${by > 0 ? "+" : "−"}${Math.abs(by)}`,
      ({ net }) => {
        const nodes = changeNodes(net, places, (place) => {
          const before = place.tokens ?? 0;
          const tokens = Math.max(0, before + by);
          if (tokens === before) return place;
          return changed(place, { tokens: tokens || undefined });
        });
        return {
          net: changeArcs(nodes, arcs, (arc) => this.weighing(arc, (arc.weight ?? 1) + by)),
        };
      },
      `count:${keys.join()}`,
    );
    return true;
  }

  weighing(arc, weight) {
    const wanted = Math.max(1, weight);
    if (wanted === (arc.weight ?? 1)) return arc;
    return changed(arc, { weight: wanted === 1 ? undefined : wanted });
  }

  /** Set the weight of an arc. Returns why not, or "". */
  setWeight(key, text) {
    const weight = Number(text);
    if (!Number.isSafeInteger(weight) || weight < 1)
      return "a weight is a whole number of at least 1";
    this.edit(`Weight ${weight} of ${this.listed([key])}`, ({ net }) => ({
      net: changeArcs(net, [key], (arc) => this.weighing(arc, weight)),
    }));
    return "";
  }

  toggleInhibitor() {
    const arcs = this.chosen("arc");
    const places = new Set(this.net.places.map(({ name }) => name));
    const fit = this.net.arcs.filter((arc) => arcs.includes(arcKey(arc)) && places.has(arc.from));
    if (!fit.length) {
      this.mode.say("Select arcs from a place to a transition: only those can inhibit.");
      return;
    }
    const on = fit.some((arc) => !arc.inhibitor);
    const keys = fit.map(arcKey);
    this.edit(
      on ? `Let ${this.listed(keys)} inhibit` : `Make ${this.listed(keys)} an ordinary arc`,
      ({ net }) => ({
        net: changeArcs(net, keys, (arc) =>
          Boolean(arc.inhibitor) === on ? arc : changed(arc, { inhibitor: on || undefined }),
        ),
      }),
    );
  }

  toggleTimed() {
    const keys = this.chosen("transition");
    if (!keys.length) {
      this.mode.say("Select the transitions to make timed or immediate.");
      return;
    }
    const timed = keys.some((key) => !findNode(this.net, key).data.timed);
    this.edit(`Make ${this.listed(keys)} ${timed ? "timed" : "immediate"}`, ({ net }) => ({
      net: changeNodes(net, keys, (t) => (Boolean(t.timed) === timed ? t : otherKind(t))),
    }));
  }

  /** Rename a node. Returns why not, or "". */
  rename(key, name) {
    const { document } = this.mode;
    const { kind, data } = findNode(this.net, key);
    if (name === data.name) return "";
    const problem = problemOfName(document.state, name, data.name);
    if (problem) return problem;
    this.edit(`Rename ${data.name} to ${name}`, (state) => renamed(state, kind, data.name, name));
    this.mode.choose([nodeKey(kind, name)]);
    return "";
  }

  // -- groups --------------------------------------------------------------------------------------

  /** Make a group of the selected nodes, and ask for its title. A group that is selected with other nodes takes them
   * in. */
  group() {
    const { mode } = this;
    const { canvas } = mode;
    const nodes = this.chosenNodes();
    if (!nodes.length) {
      mode.say("Select the places and transitions of the group.");
      return;
    }
    const [known, ...more] = this.chosenGroups();
    const grows =
      known && !more.length && canvas.groups.get(known).every((it) => nodes.includes(it));
    const title = grows ? known : freeTitle(mode.document.plan, "Group 1");
    const names = nodes.filter((it) => !grows || !canvas.groupOf(it)).map(({ name }) => name);
    this.edit(`Group ${plural(nodes.length, "node")}`, ({ plan }) => ({
      plan: names.length ? withGroup(plan, names, title) : plan,
    }));
    mode.beginRename(`group:${title}`);
  }

  /** The titles of the groups in which selected nodes are. */
  chosenGroups() {
    const titles = this.chosenNodes().map((node) => this.mode.canvas.groupOf(node));
    return [...new Set(titles)].filter((title) => title !== undefined);
  }

  /** Dissolve the groups in which selected nodes are. */
  ungroup() {
    const { mode } = this;
    const titles = this.chosenGroups();
    const names = titles.flatMap((title) => mode.canvas.groups.get(title).map(({ name }) => name));
    if (!names.length) mode.say("Select a group to dissolve it.");
    else
      this.edit(`Dissolve ${titles.join(", ")}`, ({ plan }) => ({
        plan: withGroup(plan, names, ""),
      }));
  }

  /** Give a group another title. Returns why not, or "". */
  renameGroup(title, wanted) {
    if (wanted === title) return "";
    const { groups } = this.mode.document.plan;
    if (!wanted) return "a title is needed";
    if (Object.hasOwn(groups, wanted)) return `there is a group '${wanted}' already`;
    this.edit(`Rename the group ${title} to ${wanted}`, ({ plan }) => ({
      plan: {
        ...plan,
        groups: Object.fromEntries(
          Object.entries(plan.groups).map(([it, names]) => [it === title ? wanted : it, names]),
        ),
      },
    }));
    return "";
  }

  // -- moving --------------------------------------------------------------------------------------

  /** The selected nodes, as drawn. */
  chosenNodes() {
    const { canvas, selection } = this.mode;
    return [...selection].map((key) => canvas.byKey.get(key)).filter(Boolean);
  }

  /** Store the positions at which nodes are drawn now, or the given ones: name -> [x, y]. */
  move(label, points, merge = null) {
    const { canvas } = this.mode;
    const positions = new Map([...points].map(([name, [x, y]]) => [name, canvas.toDocument(x, y)]));
    this.edit(label, ({ net }) => ({ net: this.placed(net, positions) }), merge);
  }

  nudge(dx, dy) {
    const nodes = this.chosenNodes();
    if (!nodes.length) return this.nudgeBend(dx * GRID, dy * GRID);
    const keys = nodes.map(({ key }) => key);
    this.move(
      `Move ${this.listed(keys)}`,
      new Map(nodes.map(({ name, x, y }) => [name, [x + dx * GRID, y + dy * GRID]])),
      `nudge:${keys.join()}`,
    );
    return true;
  }

  arrange(how, title) {
    const nodes = this.chosenNodes();
    if (nodes.length < 2) {
      this.mode.say("Select at least two nodes.");
      return;
    }
    this.move(title, arranged(how, nodes));
  }

  async layOut() {
    const { mode } = this;
    const { state } = mode.document;
    const layout = await attempt(() => post("edit/layout", { document: state }, { id: mode.id }));
    if (!layout || mode.closed) return;
    const points = Object.entries({ ...layout.places, ...layout.transitions });
    const positions = new Map(points.map(([name, at]) => [name, mode.canvas.toDocument(...at)]));
    this.edit("Lay the net out", ({ net }) => ({ net: this.placed(unbent(net), positions) }));
    mode.canvas.camera.fit();
  }

  // -- bending arcs --------------------------------------------------------------------------------

  /** Let an arc run through points of the drawing; without any, it finds its own way. */
  bend(arc, points, merge = null) {
    const { canvas } = this.mode;
    const bends = points.map(([x, y]) => canvas.toDocument(x, y));
    this.edit(
      `${bends.length ? "Bend" : "Straighten"} ${this.listed([arc.key])}`,
      ({ net }) => ({
        net: changeArcs(net, [arc.key], (data) =>
          data === arc.data ? changed(data, { bends: bends.length ? bends : undefined }) : data,
        ),
      }),
      merge,
    );
  }

  /** By key: choose the next bend of the selected arc, or after the last one make another, halfway along the arc. */
  nextBend() {
    const { canvas } = this.mode;
    const { arc } = canvas;
    if (!arc) {
      this.mode.say("Select an arc to bend it.");
      return;
    }
    const bends = bendsOf(arc);
    const chosen = canvas.bendChosen(arc);
    const next = chosen === null ? 0 : chosen + 1;
    if (next < bends.length) {
      this.mode.say(`Bend ${next + 1} of ${bends.length}: arrows move it`);
      canvas.chooseBend(arc, next);
    } else {
      const { middle } = arc.shape;
      const at = canvas.segmentAt(arc, middle);
      bends.splice(at, 0, middle);
      this.bend(arc, bends);
      canvas.chooseBend(arc, at);
    }
  }

  /** Remove a bend; without arguments, the one that keys move. */
  removeBend(arc = this.mode.canvas.arc, bend = arc ? this.mode.canvas.bendChosen(arc) : null) {
    if (bend === null) {
      this.mode.say("B chooses a bend of the selected arc.");
      return;
    }
    const left = bendsOf(arc).filter((_, i) => i !== bend);
    this.bend(arc, left);
    this.mode.canvas.bent = null;
  }

  /** Move the chosen bend of the selected arc. Returns whether there is one. */
  nudgeBend(dx, dy) {
    const { canvas } = this.mode;
    const { arc } = canvas;
    const chosen = arc ? canvas.bendChosen(arc) : null;
    if (chosen === null) return false;
    const bends = bendsOf(arc);
    bends[chosen] = [bends[chosen][0] + dx, bends[chosen][1] + dy];
    this.bend(arc, bends, `bend:${arc.key}:${chosen}`);
    return true;
  }

  // -- selecting, copying --------------------------------------------------------------------------

  selectAll() {
    const { canvas } = this.mode;
    this.mode.choose([...canvas.byKey.keys(), ...canvas.arcsByKey.keys()]);
    this.mode.say(`${plural(this.mode.selection.size, "element")} chosen`);
  }

  /** The selection as a part of a net; null, with a message, if no node is selected. */
  part(act) {
    const { mode } = this;
    const part = copied(mode.document.state, mode.selection, mode.canvas.positions());
    if (!part) mode.say(`Select places or transitions to ${act}.`);
    return part;
  }

  /** The selection as text; it is also kept here. */
  copy() {
    const part = this.part("copy");
    if (!part) return "";
    kept = partText(part);
    this.mode.say(`${plural(this.chosenNodes().length, "node")} copied`);
    return kept;
  }

  cut() {
    const text = this.copy();
    if (text) this.remove();
    return text;
  }

  /** Paste a text, or the last copy. */
  async paste(text = kept) {
    const part = parsed(text, await planSchema());
    if (part) this.insert(part, "Paste");
    else this.mode.say("The clipboard does not contain a part of a net.");
  }

  duplicate() {
    const part = this.part("duplicate");
    if (part) this.insert(part, "Duplicate");
  }

  /** Add a part of a net where it was drawn, or with its middle at a spot, drawn as large as it says (px). */
  insert(part, word, spot = null) {
    const { canvas } = this.mode;
    const nodes = [...part.places, ...part.transitions];
    const scale = spot ? 1 : canvas.scale;
    const { clientWidth, clientHeight } = canvas.container;
    const [low, high] = [canvas.toDrawing(0, 0), canvas.toDrawing(clientWidth, clientHeight)];
    /** How far to move along an axis: with the middle to the spot, but with all of it in view. */
    const way = (axis) => {
      const values = nodes.map(({ position }) => position[axis]);
      const [least, most] = [Math.min(...values), Math.max(...values)];
      const inside = Math.min(spot[axis] - (least + most) / 2, high[axis] - EDGE - most);
      return onGrid(Math.max(inside, low[axis] + EDGE - least));
    };
    const [right, down] = spot ? [way(0), way(1)] : [0, 0];
    const drawn = nodes.map(({ position: [x, y] }) => [x * scale + right, y * scale + down]);
    // next to the original, or farther away if that spot is taken
    let shift = 0;
    const taken = (d) =>
      drawn.some(([x, y]) =>
        canvas.nodes.some((node) => Math.hypot(node.x - x - d, node.y - y - d) < (spot ? 50 : 15)),
      );
    while (taken(shift)) shift += 40;
    const moved = (x, y) => canvas.toDocument(x * scale + right + shift, y * scale + down + shift);
    const copy = fitted(part, this.net, moved);
    this.edit(`${word} ${plural(nodes.length, "node")}`, ({ net, plan }) => {
      const values = {};
      if (Object.keys(copy.actions).length) values.actions = { ...plan?.actions, ...copy.actions };
      if (copy.resources.length)
        values.resource_places = [...(plan?.resource_places || []), ...copy.resources];
      let all = Object.keys(values).length ? { ...plan, ...values } : plan;
      for (const [title, names] of Object.entries(copy.groups))
        all = withGroup(all, names, freeTitle(all, title));
      return { net: this.placed(addParts(net, copy)), plan: all };
    });
    this.mode.choose([
      ...copy.places.map(({ name }) => nodeKey("place", name)),
      ...copy.transitions.map(({ name }) => nodeKey("transition", name)),
    ]);
  }

  // -- subnets -------------------------------------------------------------------------------------

  /** Open the file of the subnet that a place stands for. Returns false if the place stands for none. */
  openSubnet(key) {
    const { canvas, opened, page } = this.mode;
    const node = canvas.byKey.get(key);
    const file = node?.type === "place" ? canvas.subnetOf(node.name) : null;
    if (!file) return false;
    const parts = opened.path.split("/");
    if (parts[parts.length - 1].includes(".")) parts.pop(); // a file; anything else is a folder with a plan
    for (const part of file.split("/"))
      if (part === "..") parts.pop();
      else if (part !== "." && part !== "") parts.push(part);
    page.editor.enter(`file-${parts.join("/")}`);
    return true;
  }
}
