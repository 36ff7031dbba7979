// The keys of the mode EDIT, and their table.

import { attempt, dialogOpen } from "../dom.js";

const TYPING = 400; // ms within which a second key turns both into a name, after a node was added by key

/** The entries of the help: [keys, effect]. */
export const EDIT_KEYS = [
  ["P  T  I", "add a place, a timed or an immediate transition at the pointer"],
  ["Shift + P  T  I", "the same, with an arc from the selected node"],
  ["A", "an arc from the selected node: ← → or the list choose its end, Enter makes it"],
  ["any name", "after a node was added: its name"],
  ["F2, Enter", "rename the selected node; edit the weight of the selected arc"],
  ["+  −", "tokens of the selected places, weight of the selected arcs; otherwise zoom"],
  ["H", "make the selected arcs inhibitor arcs, and back"],
  [
    "drag an arc, or B",
    "bend it; drag a bend, or ← → ↑ ↓, to move it; B: the next bend, or a new one",
  ],
  ["double click a bend, or Shift + B", "remove it"],
  ["X", "make the selected transitions timed or immediate"],
  ["← → ↑ ↓", "move the selection (with Shift: farther), or the view if nothing is selected"],
  ["Ctrl + ← → ↑ ↓", "select the next node in that direction (Shift: add it to the selection)"],
  ["↑ ↓ in the list", "select the next element (Shift: add it to the selection)"],
  ["Ctrl + ↑ ↓, Space", "in the list: go to the next element; select or deselect it"],
  ["Delete", "delete the selection"],
  ["Ctrl + A", "select everything"],
  ["Ctrl + C  X  V  D", "copy, cut, paste, duplicate"],
  ["Ctrl + G", "make the selected nodes a group; F2 changes its title"],
  ["Ctrl + Shift + G", "dissolve the group of the selected nodes"],
  ["click, double click a node of a group", "select the group, the node"],
  ["Ctrl + Z,  Ctrl + Y", "undo, redo (also Ctrl + Shift + Z)"],
  ["Ctrl + S", "save"],
  ["Ctrl + Enter", "open the subnet of the selected place"],
  ["Space + drag", "move the view (also the middle button, or a finger)"],
  ["F", "fit the net"],
  ["/", "search the list"],
  ["Esc", "end a tool, clear the selection"],
];

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const ADDS = { p: "place", t: "timed", i: "immediate" };
const FAR = 5; // steps of the grid that Shift and an arrow move
const PAN = 60; // px that an arrow moves the view

const isField = (target) =>
  target.matches?.("input:not([type=checkbox]):not([type=radio]), textarea, select") ||
  target.isContentEditable;

/** Keys pressed after a node was added by key. They may start its name or draw the next node, so a drawing key waits a
 * moment for a second key. Shift + P, T or I always draws. */
class Typed {
  constructor(mode, act) {
    this.mode = mode;
    this.act = act;
    this.waiting = []; // key events not interpreted yet
    this.timer = 0;
  }

  /** The node that was added, if nothing has been done since. */
  get added() {
    const { added, document: edited, selection } = this.mode;
    const fresh = added?.state === edited.state && selection.size === 1 && selection.has(added.key);
    return fresh && !this.mode.tool ? added.key : null;
  }

  /** Handle a key. Returns whether it was used. */
  take(event) {
    const { added } = this;
    const writes = event.key.length === 1 && event.key !== " " && !event.altKey;
    if (!added || !(writes || (this.waiting.length && event.key === " ")) || event.isComposing) {
      this.draw();
      return false;
    }
    event.preventDefault();
    if (event.repeat) return true; // the key that added it is held down
    clearTimeout(this.timer);
    this.waiting.push(event);
    const text = this.waiting.map(({ key }) => key).join("");
    if (/^[PTI]+$/.test(text) || (text.length === 1 && alone(event, this.mode)))
      this.timer = setTimeout(() => this.draw(), TYPING);
    else {
      this.waiting = [];
      this.mode.beginRename(added, text);
    }
    return true;
  }

  /** The waiting keys were meant for the drawing. */
  draw() {
    clearTimeout(this.timer);
    for (const event of this.waiting.splice(0)) this.act(event);
  }
}

/** Bind the keys of the editor until `signal` aborts. */
export function bindEditKeys(mode, signal) {
  const free = (event) =>
    !dialogOpen() && !isField(event.target) && document.getSelection().isCollapsed;
  const typed = new Typed(mode, (event) => {
    const action = alone(event, mode);
    if (action) attempt(action);
  });
  signal.addEventListener("abort", () => clearTimeout(typed.timer));
  document.addEventListener(
    "keydown",
    (event) => {
      if (dialogOpen()) return;
      const saves = (event.ctrlKey || event.metaKey) && event.key.toLowerCase() === "s";
      if (isField(event.target) && !saves) return;
      if (["Shift", "Control", "Alt", "Meta"].includes(event.key)) return;
      if (event.ctrlKey || event.metaKey) typed.draw();
      else if (typed.take(event)) return;
      if (event.key === " " && event.target === mode.canvas.container) {
        event.preventDefault();
        mode.panning = true;
        return;
      }
      const action = event.ctrlKey || event.metaKey ? withControl(event, mode) : alone(event, mode);
      if (!action) return;
      event.preventDefault();
      attempt(action);
    },
    { signal },
  );
  document.addEventListener("keyup", () => (mode.panning = false), { signal });
  const clip = (name, take) =>
    document.addEventListener(
      name,
      (event) => {
        if (!free(event)) return;
        event.preventDefault();
        take(event.clipboardData);
      },
      { signal },
    );
  const put = (data, text) => text && data.setData("text/plain", text);
  clip("copy", (data) => put(data, mode.actions.copy()));
  clip("cut", (data) => put(data, mode.actions.cut()));
  clip("paste", (data) => {
    const text = data.getData("text/plain") || undefined;
    attempt(() => mode.actions.paste(text));
  });
}

function withControl(event, mode) {
  const { actions, selection } = mode;
  const step = ARROWS[event.key];
  if (step) return () => mode.chooseBeside(...step, event.shiftKey);
  const acts = {
    z: () => (event.shiftKey ? mode.redo() : mode.undo()),
    y: () => mode.redo(),
    s: () => mode.files.save(),
    a: () => actions.selectAll(),
    d: () => actions.duplicate(),
    g: () => (event.shiftKey ? actions.ungroup() : actions.group()),
    enter: () => selection.size === 1 && actions.openSubnet([...selection][0]),
  };
  return acts[event.key.toLowerCase()] || null;
}

function alone(event, mode) {
  if (event.altKey) return null;
  const { actions, canvas, selection } = mode;
  const target = event.target;
  const onButton = target.matches("button, summary, [role=tab], [role=separator], a");
  if (onButton && ["Enter", " "].includes(event.key)) return null;
  const step = ARROWS[event.key];
  if (step) {
    if (target.matches("[role=tab]")) return null;
    if (mode.tool === "arc" && mode.arcStart) return () => mode.aimNext(step[0] + step[1]);
    if (target.closest("[role=tabpanel], [role=region]")) return null; // they scroll
    const by = event.shiftKey ? FAR : 1;
    if (!selection.size) return () => canvas.camera.pan(-step[0] * by * PAN, -step[1] * by * PAN);
    return () => actions.nudge(step[0] * by, step[1] * by);
  }
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if (ADDS[key]) return () => actions.addHere(ADDS[key], event.shiftKey);
  const more = () => actions.count(1) || canvas.camera.zoom(1.25);
  const remove = () => actions.remove();
  const { group } = canvas;
  const one =
    selection.size === 1 ? [...selection][0] : group === undefined ? null : `group:${group}`;
  const rename = one && (() => mode.beginRename(one));
  const ends = mode.tool === "arc" && mode.arcEnd && (() => mode.arcTo(mode.arcEnd));
  const acts = {
    a: () => mode.beginArc(),
    h: () => actions.toggleInhibitor(),
    b: () => (event.shiftKey ? actions.removeBend() : actions.nextBend()),
    x: () => actions.toggleTimed(),
    "+": more,
    "=": more,
    "-": () => actions.count(-1) || canvas.camera.zoom(0.8),
    f: () => canvas.camera.fit(),
    "/": () => mode.list.search.focus(),
    Delete: remove,
    Backspace: remove,
    Enter: ends || rename,
    F2: rename,
    Escape: () => mode.escape(),
  };
  return acts[key] || null;
}
