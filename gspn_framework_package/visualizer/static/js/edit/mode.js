// The mode EDIT: its section of the page, and what its parts share. Each panel and each tool is a separate part.

import { $, h, attempt, menu, nextTab, textField, withArticle } from "../dom.js";
import { post } from "../api.js";
import { Actions, WORDS } from "./actions.js";
import { ARRANGEMENTS } from "./arrange.js";
import { Beginning } from "./beginning.js";
import { Canvas } from "./canvas.js";
import { CanvasPointer } from "./canvas_pointer.js";
import { Checks } from "./checks.js";
import { DiffView } from "./diff_view.js";
import { bindEditKeys } from "./edit_keys.js";
import { ElementList } from "./element_list.js";
import { iconOf } from "./icons.js";
import { Files } from "./files.js";
import { actOnChoice } from "./menus.js";
import { boxOf } from "../net_nodes.js";
import { problemOfArc } from "./net_edits.js";
import { CommonParts } from "./common_parts.js";
import { PlanDocument } from "./plan_document.js";
import { WhatHappens } from "./what_happens.js";
import { Witness } from "./witness.js";
import { PlanPanel } from "./plan_panel.js";
import { PolicyPanel } from "./policy_panel.js";
import { PropertyPanel } from "./property_panel.js";
import { Together } from "./together.js";

/** The parts of the editor. They are constructed in this order with the mode; a part may have `close()`. */
const PARTS = [
  PropertyPanel,
  PlanPanel,
  PolicyPanel,
  Checks,
  WhatHappens,
  DiffView,
  Files,
  Together,
  Beginning,
  CommonParts,
];

/** The names of the groups of the tool bar, in their order. */
const GROUPS = ["file", "history", "add", "change", "arrange", "look"];

/** One document being edited. Fires "select" (detail: the Set of selected keys), "frame" and
 * "functions" (one was written). */
export class EditMode extends EventTarget {
  /** `opened`: the answer to GET edit; `document`: the one that was left open, if any; `crumbs`: the files that led
   * here, [[id, name], ...]. */
  constructor(page, id, opened, { document: kept = null, crumbs = [] } = {}) {
    super();
    this.page = page;
    this.id = id;
    this.opened = opened;
    this.visit = Math.random().toString(36).slice(2); // tells this page from others that edit the same file
    this.document = kept || new PlanDocument(opened.document);
    this.selection = new Set();
    this.panels = new Map(); // name -> {tab, panel}
    this.tool = null; // the active tool: "place", "timed", "immediate" or "arc"
    this.arcStart = this.arcEnd = null; // keys of the nodes of the arc being made
    this.panning = false; // whether dragging moves the view
    this.witness = null; // the sequence being played
    this.added = null; // {key, state}: the node last added by key, and the state of the document then
    this.bound = new AbortController(); // aborts when the mode is left
    this.build(crumbs);
    this.canvas = new Canvas($("ed-net"), this.document, opened.scale);
    this.actions = new Actions(this);
    this.pointer = new CanvasPointer(this);
    this.list = new ElementList(this);
    bindEditKeys(this, this.bound.signal);
    this.canvas.addEventListener("frame", () => this.dispatchEvent(new CustomEvent("frame")));
    this.onDocument(() => this.refresh(), "change", "saved");
    this.buttons();
    this.parts = PARTS.map((Part) => new Part(this));
    this.refresh();
    this.layOut();
  }

  build(crumbs) {
    const path = this.opened.path;
    const trail = [...crumbs, [this.id, path]];
    $("ed-page").replaceChildren(
      h(
        "div.tools",
        { id: "ed-tools", role: "toolbar", "aria-label": "Editing" },
        GROUPS.map((group) => h("div.ed-group", { id: `ed-group-${group}`, hidden: true })),
      ),
      h(
        "section.left",
        { "aria-label": "Places, transitions and arcs" },
        h("div.ed-list", { id: "ed-list-box" }),
      ),
      h(
        "section.centre",
        { "aria-label": "Drawing" },
        h(
          "nav.ed-crumbs",
          { id: "ed-crumbs", "aria-label": "Files", hidden: !crumbs.length },
          trail.map(([id, name], i) =>
            i === trail.length - 1
              ? h("strong", { "aria-current": "page", text: name })
              : [
                  h("button.link", { text: name, onclick: () => this.page.edit(id) }),
                  h("span", { "aria-hidden": "true", text: " › " }),
                ],
          ),
        ),
        h(
          "div.frame",
          { id: "ed-frame" },
          h("div.net.ed-net", {
            id: "ed-net",
            tabindex: "0",
            role: "application",
            "aria-label": "The drawing. The list of nodes next to it has the same content.",
          }),
          h("div.zoom", { id: "ed-zoom", role: "group", "aria-label": "View" }),
        ),
        h("div.ed-foot", { id: "ed-foot" }, h("p.ed-status", { id: "ed-status", role: "status" })),
      ),
      h(
        "section.right",
        { id: "ed-right", "aria-label": "Properties", hidden: true },
        h("div.tablist", {
          id: "ed-tabs",
          role: "tablist",
          "aria-label": "Properties",
        }),
      ),
    );
  }

  /** Show nodes without positions where the server's layout puts them. */
  async layOut() {
    const { places, transitions } = this.document.net;
    if ([...places, ...transitions].every((node) => node.position)) return;
    try {
      const layout = await post("edit/layout", { document: this.document.state }, { id: this.id });
      if (!this.closed) this.canvas.useLayout(layout);
    } catch (error) {
      this.say(`The nodes are drawn on a grid because they cannot be laid out: ${error.message}.`);
    }
  }

  // -- services for the parts --------------------------------------------------------------------------

  /** Call `act` at these events of the document, until the mode is left. */
  onDocument(act, ...events) {
    for (const event of events)
      this.document.addEventListener(event, act, { signal: this.bound.signal });
  }

  /** Show a text under the drawing and announce it to screen readers. */
  say(text) {
    $("ed-status").textContent = text;
  }

  /** Add a tab to the right section. */
  panel(name, title, element) {
    const show = () => this.showPanel(name);
    const tab = h("button", {
      role: "tab",
      id: `ed-tab-${name}`,
      "aria-controls": `ed-panel-${name}`,
      text: title,
      onclick: show,
      onkeydown: (event) => {
        const next = nextTab(event, [...this.panels.keys()], name);
        if (!next) return;
        this.showPanel(next);
        this.panels.get(next).tab.focus();
      },
    });
    const panel = h(
      "div.panel",
      {
        id: `ed-panel-${name}`,
        role: "tabpanel",
        "aria-labelledby": tab.id,
        tabindex: "0",
      },
      element,
    );
    this.panels.set(name, { tab, panel });
    $("ed-tabs").append(tab);
    $("ed-right").append(panel);
    $("ed-right").hidden = false;
    this.showPanel(this.panels.keys().next().value);
  }

  showPanel(name) {
    for (const [other, { tab, panel }] of this.panels) {
      const on = other === name;
      tab.setAttribute("aria-selected", on);
      tab.tabIndex = on ? 0 : -1;
      panel.hidden = !on;
    }
  }

  /** Add a button to a group of the tool bar (one of GROUPS): {label, title, key, onclick}, where `key` names the key
   * with the same effect. Returns the element. */
  button(group, { label, title = label, key = "", onclick, ...attributes }) {
    const element = h(
      "button",
      { title: key ? `${title} (${key})` : title, onclick, ...attributes },
      iconOf(attributes.id),
      h("span", label),
    );
    const box = $(`ed-group-${group}`);
    box.append(element);
    box.hidden = false;
    return element;
  }

  /** Select elements by their keys; keys of missing elements are ignored. */
  choose(keys) {
    const { canvas } = this;
    this.selection = new Set(
      [...keys].filter((key) => canvas.byKey.has(key) || canvas.arcsByKey.has(key)),
    );
    canvas.select(this.selection);
    this.dispatchEvent(new CustomEvent("select", { detail: this.selection }));
  }

  /** Play a firing sequence on the drawing; the arguments are those of Witness. */
  play(steps, markings) {
    this.witness?.end();
    this.witness = new Witness(this, steps, markings);
  }

  // -- the tool bar --------------------------------------------------------------------------------

  buttons() {
    const { actions } = this;
    this.undoButton = this.button("history", {
      id: "ed-undo",
      label: "Undo",
      key: "Ctrl+Z",
      onclick: () => this.undo(),
    });
    this.redoButton = this.button("history", {
      id: "ed-redo",
      label: "Redo",
      key: "Ctrl+Y",
      onclick: () => this.redo(),
    });
    // with the pointer, the next click places the node; by key, it is placed at once
    const add = (what, label, key) =>
      this.button("add", {
        id: `ed-add-${what}`,
        label,
        title: `Add ${withArticle(WORDS[what])}`,
        key,
        "aria-pressed": "false",
        onclick: (event) => {
          if (event.detail) this.setTool(this.tool === what ? null : what);
          else actions.addHere(what);
        },
      });
    this.toolButtons = {
      place: add("place", "Place", "P"),
      timed: add("timed", "Timed", "T"),
      immediate: add("immediate", "Immediate", "I"),
      arc: this.button("add", {
        id: "ed-arc",
        label: "Arc",
        title: "Draw an arc",
        key: "A",
        "aria-pressed": "false",
        onclick: () => (this.tool === "arc" ? this.setTool(null) : this.beginArc()),
      }),
    };
    const change = (id, label, title, key, onclick) =>
      this.button("change", { id, label, title, key, onclick });
    change("ed-delete", "Delete", "Delete the selection", "Delete", () => actions.remove());
    change("ed-more", "More", "More tokens, or a higher weight", "+", () => actions.count(1));
    change("ed-less", "Fewer", "Fewer tokens, or a lower weight", "−", () => actions.count(-1));
    change("ed-inhibit", "Inhibit", "Make the selected arcs inhibitor arcs, and back", "H", () =>
      actions.toggleInhibitor(),
    );
    change("ed-timed", "Other kind", "Switch transitions between timed and immediate", "X", () =>
      actions.toggleTimed(),
    );
    this.arrangeMenu();
    this.zoomButtons();
  }

  arrangeMenu() {
    const MORE = [
      ["copy", "Copy", () => this.toClipboard(this.actions.copy())],
      ["cut", "Cut", () => this.toClipboard(this.actions.cut())],
      ["paste", "Paste", () => this.actions.paste()],
      ["duplicate", "Duplicate", () => this.actions.duplicate()],
      ["group", "Group", () => this.actions.group()],
      ["ungroup", "Dissolve the group", () => this.actions.ungroup()],
      ["layout", "Lay the net out", () => this.actions.layOut()],
    ];
    const acts = new Map([
      ...MORE.map(([word, , act]) => [word, act]),
      ...ARRANGEMENTS.map(([word, title]) => [word, () => this.actions.arrange(word, title)]),
    ]);
    const choice = menu([["", "More …"], ...MORE, ...ARRANGEMENTS], {
      id: "ed-arrange",
      "aria-label": "Copy and arrange",
      title: "Arrow keys move to an entry, Enter chooses it",
    });
    actOnChoice(choice, (word) => attempt(acts.get(word)));
    $("ed-group-arrange").append(choice);
    $("ed-group-arrange").hidden = false;
  }

  /** Put a text on the system's clipboard if the browser allows it. */
  async toClipboard(text) {
    if (text) await navigator.clipboard?.writeText(text).catch(() => {});
  }

  zoomButtons() {
    const { camera } = this.canvas;
    const button = (id, title, onclick) => {
      const icon = $(id).firstElementChild.cloneNode(true);
      return h("button.icon", { id: `ed-${id}`, title, "aria-label": title, onclick }, icon);
    };
    $("ed-zoom").append(
      button("zoom-in", "Zoom in", () => camera.zoom(1.25)),
      button("zoom-out", "Zoom out", () => camera.zoom(0.8)),
      button("fit", "Fit the net (F)", () => camera.fit()),
    );
  }

  setTool(tool) {
    this.tool = tool;
    if (tool !== "arc") this.aimFrom(null);
    for (const [name, button] of Object.entries(this.toolButtons))
      button.setAttribute("aria-pressed", name === tool);
    this.canvas.container.classList.toggle("adding", Boolean(tool));
    if (tool && tool !== "arc")
      this.say(`Click where the ${WORDS[tool]} should be (Shift: several; Esc: none).`);
  }

  // -- an arc by keys ------------------------------------------------------------------------------

  /** Begin an arc at the selected node or, if none is selected, at the first node clicked. */
  beginArc() {
    const start = [...this.selection].filter((key) => this.canvas.byKey.has(key));
    this.setTool("arc");
    if (start.length === 1) this.aimFrom(start[0]);
    else this.say("Click the node that the arc comes from, then the one it leads to.");
  }

  aimFrom(key) {
    this.arcStart = key;
    this.arcEnds = [];
    this.aim(null);
    if (!key) return;
    const from = this.canvas.byKey.get(key);
    const apart = (node) => Math.hypot(node.x - from.x, node.y - from.y);
    this.arcEnds = this.canvas.nodes
      .filter((node) => !problemOfArc(this.document.net, key, node.key))
      .sort((a, b) => apart(a) - apart(b))
      .map((node) => node.key);
    this.say(
      `An arc from ${from.name}: choose its end with ← and → or in the list, then press Enter.`,
    );
  }

  /** End the arc being made at a node. */
  aim(key) {
    if (key && !this.canvas.byKey.has(key)) {
      this.say("Select a place or a transition.");
      return;
    }
    this.canvas.byKey.get(this.arcEnd)?.element.classList.remove("aimed");
    this.arcEnd = key;
    const node = this.canvas.byKey.get(key);
    if (node) {
      node.element.classList.add("aimed");
      this.canvas.flyTo(key);
      const problem = problemOfArc(this.document.net, this.arcStart, key);
      const from = this.canvas.byKey.get(this.arcStart).name;
      this.say(problem || `An arc from ${from} to ${node.name}: press Enter to add it.`);
    }
    this.list.mark();
  }

  aimNext(step) {
    const { arcEnds } = this;
    if (!arcEnds.length) {
      this.say("There is no other node that an arc from here may lead to.");
      return;
    }
    const at = arcEnds.indexOf(this.arcEnd);
    const next = at < 0 ? 0 : (at + step + arcEnds.length) % arcEnds.length;
    this.aim(arcEnds[next]);
  }

  /** A node was selected while an arc is being made: it becomes the start or the end. */
  arcTo(key) {
    if (!this.arcStart) this.aimFrom(key);
    else if (this.actions.connect(this.arcStart, key)) this.setTool(null);
  }

  /** Select the nearest node in a direction; `more`: add it to the selection. */
  chooseBeside(dx, dy, more = false) {
    const from = this.canvas.byKey.get([...this.selection].pop()) || this.canvas.nodes[0];
    if (!from) return;
    let [best, least] = [null, Infinity];
    for (const node of this.canvas.nodes) {
      const [x, y] = [node.x - from.x, node.y - from.y];
      const along = x * dx + y * dy;
      const aside = Math.abs(x * dy - y * dx);
      if (along <= 0 || along + 2 * aside >= least) continue;
      [best, least] = [node, along + 2 * aside];
    }
    if (!best && this.selection.size) return;
    const { key } = best || from;
    this.choose(more ? [...[...this.selection].filter((it) => it !== key), key] : [key]);
    this.canvas.flyTo(key);
    const { size } = this.selection;
    this.say(`${(best || from).name} chosen${size > 1 ? `, ${size} in all` : ""}`);
  }

  escape() {
    if (this.pointer.gesture) this.pointer.cancel();
    else if (this.tool) {
      this.setTool(null);
      this.say("");
    } else if (this.witness) this.witness.end();
    else this.choose([]);
  }

  // -- renaming in place ---------------------------------------------------------------------------

  /** Edit the name of a node, the title of a group ("group:TITLE") or the weight of an arc in place; `typed`: the part
   * of the name typed so far. */
  beginRename(key, typed = null) {
    this.endRename(true);
    const { canvas, actions } = this;
    const node = canvas.byKey.get(key);
    const arc = canvas.arcsByKey.get(key)?.[0];
    const title = key.startsWith("group:") ? key.slice("group:".length) : null;
    const members = canvas.groups.get(title);
    if (!node && !arc && !members) return;
    const [left, top] = members ? boxOf(members, title) : [];
    const { k, x: x0, y: y0 } = canvas.camera.now;
    const [x, y] = node ? [node.x, node.y] : members ? [left + 90 / k, top] : arc.shape.middle;
    const field = textField({
      id: "ed-name",
      class: "ed-name",
      value: node?.name ?? title ?? String(arc.data.weight ?? 1),
      "aria-label": node
        ? `Name of ${node.name}`
        : members
          ? `Title of the group ${title}`
          : `Weight of the arc ${arc.data.from} → ${arc.data.to}`,
      onkeydown: (event) => {
        const { key: pressed, ctrlKey, metaKey, shiftKey } = event;
        if (pressed === "Enter") this.endRename(true, true);
        else if (pressed === "Escape") this.endRename(false);
        else if (
          (ctrlKey || metaKey) &&
          /^[zy]$/i.test(pressed) &&
          field.value === field.defaultValue
        ) {
          this.endRename(false); // nothing was typed: the key applies to the node
          if (pressed.toLowerCase() === "z" && !shiftKey) this.undo();
          else this.redo();
        } else return;
        event.preventDefault();
        event.stopPropagation();
      },
      onblur: () => this.endRename(true, false, false),
    });
    const { width, height } = canvas.container.getBoundingClientRect();
    field.style.left = `${Math.max(4, Math.min(width - 190, x * k + x0 - 90))}px`;
    field.style.top = `${Math.max(4, Math.min(height - 36, y * k + y0 + (node ? 24 * k : -14)))}px`;
    const put = (text) =>
      node
        ? actions.rename(key, text.trim())
        : members
          ? actions.renameGroup(title, text.trim())
          : actions.setWeight(key, text);
    this.renaming = { field, put };
    $("ed-frame").append(field);
    field.focus();
    if (typed === null) field.select();
    else field.value = typed;
  }

  /** End renaming; `keep`: use the content of the field. An invalid name is reported, and the field stays open if
   * `insist`. `returns`: give the focus back to the drawing. */
  endRename(keep, insist = false, returns = true) {
    const { renaming } = this;
    if (!renaming) return;
    const problem = keep ? renaming.put(renaming.field.value) : "";
    if (problem) this.say(`${problem[0].toUpperCase()}${problem.slice(1)}.`);
    if (problem && insist) {
      renaming.field.setAttribute("aria-invalid", "true");
      return;
    }
    this.renaming = null;
    renaming.field.remove();
    if (returns) this.canvas.container.focus({ preventScroll: true });
  }

  undo() {
    this.witness?.end();
    const edit = this.document.undo();
    this.say(edit ? `Undone: ${edit.label}` : "There is nothing to undo.");
  }

  redo() {
    this.witness?.end();
    const edit = this.document.redo();
    this.say(edit ? `Redone: ${edit.label}` : "There is nothing to redo.");
  }

  /** The document was changed or saved. */
  refresh() {
    const { document: edited } = this;
    this.undoButton.disabled = !edited.done.length;
    this.redoButton.disabled = !edited.undone.length;
    const name = edited.plan?.plan || edited.net.name || this.opened.path;
    $("title").textContent = name;
    $("subtitle").textContent = `${this.opened.path}${edited.dirty ? " · not saved" : ""}`;
    window.document.title = `${edited.dirty ? "• " : ""}${name} · GSPN`;
    if ([...this.selection].some((key) => !this.canvas.elementsOf(key).length))
      this.choose(this.selection);
  }

  close() {
    this.closed = true;
    this.endRename(false);
    this.bound.abort();
    for (const part of this.parts) part.close?.();
    this.witness?.end();
    this.list.close();
    this.canvas.close();
    $("ed-page").replaceChildren();
  }
}
