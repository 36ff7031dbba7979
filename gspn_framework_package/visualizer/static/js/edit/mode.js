// The mode EDIT: its part of the page, and what its parts share. Each panel and each tool is a part of its own.

import { $, h, announce, ask } from "../dom.js";
import { post } from "../api.js";
import { Canvas } from "./canvas.js";
import { PlanDocument } from "./plan_document.js";

/** The parts of the editor, made in this order, each with the mode. A part may have `close()`. */
const PARTS = [];

/** The names of the groups of the tool bar, in their order. */
const GROUPS = ["file", "history", "add", "change", "arrange", "look"];

/** One document that is being edited. Fires "select" (detail: the Set of chosen keys) and "frame". */
export class EditMode extends EventTarget {
  /** `opened`: the answer to GET edit; `document`: the one that was left open, if any; `crumbs`: the files that led
   * here, [[id, name], ...]. */
  constructor(page, id, opened, { document: kept = null, crumbs = [] } = {}) {
    super();
    this.page = page;
    this.id = id;
    this.opened = opened;
    this.document = kept || new PlanDocument(opened.document);
    this.selection = new Set();
    this.panels = new Map(); // name -> {tab, panel}
    this.build(crumbs);
    this.canvas = new Canvas($("ed-net"), this.document);
    this.canvas.addEventListener("frame", () => this.dispatchEvent(new CustomEvent("frame")));
    this.changed = () => this.refresh();
    this.document.addEventListener("change", this.changed);
    this.document.addEventListener("saved", this.changed);
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
        "section",
        { class: "left", "aria-label": "Places, transitions and arcs" },
        h("div", { class: "ed-list", id: "ed-list-box" }),
      ),
      h(
        "section",
        { class: "centre", "aria-label": "Drawing" },
        h(
          "div",
          { id: "ed-tools", class: "tools", role: "toolbar", "aria-label": "Editing" },
          GROUPS.map((group) =>
            h("div", { class: "ed-group", id: `ed-group-${group}`, hidden: true }),
          ),
        ),
        h(
          "nav",
          { id: "ed-crumbs", class: "ed-crumbs", "aria-label": "Files", hidden: !crumbs.length },
          trail.map(([id, name], i) =>
            i === trail.length - 1
              ? h("strong", { "aria-current": "page", text: name })
              : [
                  h("button", { class: "link", text: name, onclick: () => this.page.edit(id) }),
                  h("span", { "aria-hidden": "true", text: " › " }),
                ],
          ),
        ),
        h(
          "div",
          { id: "ed-frame", class: "frame" },
          h("div", {
            id: "ed-net",
            class: "net ed-net",
            tabindex: "0",
            role: "application",
            "aria-label": "The drawing. The list of nodes beside it holds the same.",
          }),
          h("div", { id: "ed-zoom", class: "zoom", role: "group", "aria-label": "View" }),
        ),
        h("p", { id: "ed-status", class: "ed-status", role: "status" }),
      ),
      h(
        "section",
        { class: "right", id: "ed-right", "aria-label": "Properties", hidden: true },
        h("div", {
          class: "tablist",
          id: "ed-tabs",
          role: "tablist",
          "aria-label": "Properties",
        }),
      ),
    );
  }

  /** Nodes without positions are shown as the server lays them out. */
  async layOut() {
    const { places, transitions } = this.document.net;
    if ([...places, ...transitions].every((node) => node.position)) return;
    try {
      const layout = await post("edit/layout", { document: this.document.state }, { id: this.id });
      if (!this.closed) this.canvas.useLayout(layout);
    } catch (error) {
      this.say(`The nodes are drawn on a grid, for they cannot be laid out: ${error.message}.`);
    }
  }

  // -- what the parts use --------------------------------------------------------------------------

  /** Say something under the drawing, and to screen readers. */
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
        const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
        if (!step) return;
        event.preventDefault();
        const names = [...this.panels.keys()];
        const next = names[(names.indexOf(name) + step + names.length) % names.length];
        this.showPanel(next);
        this.panels.get(next).tab.focus();
      },
    });
    const panel = h(
      "div",
      {
        id: `ed-panel-${name}`,
        class: "panel",
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

  /** Add a button to a group of the tool bar (one of GROUPS): {label, title, key, onclick}, where `key` is the name of
   * the key that does the same. Returns the element. */
  button(group, { label, title = label, key = "", onclick, ...attributes }) {
    const element = h("button", {
      text: label,
      title: key ? `${title} (${key})` : title,
      onclick,
      ...attributes,
    });
    const box = $(`ed-group-${group}`);
    box.append(element);
    box.hidden = false;
    return element;
  }

  /** Choose elements, by their keys; those that do not exist are left out. */
  choose(keys) {
    const { canvas } = this;
    this.selection = new Set(
      [...keys].filter((key) => canvas.byKey.has(key) || canvas.arcsByKey.has(key)),
    );
    canvas.select(this.selection);
    this.dispatchEvent(new CustomEvent("select", { detail: this.selection }));
  }

  flyTo(key) {
    this.canvas.flyTo(key);
  }

  /** Draw marks at nodes: key -> {level: "error" | "warning" | "note", text}. */
  mark(marks) {
    this.canvas.mark(marks);
  }

  // -- the tool bar --------------------------------------------------------------------------------

  buttons() {
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
  }

  undo() {
    const edit = this.document.undo();
    this.say(edit ? `Undone: ${edit.label}` : "There is nothing to undo.");
  }

  redo() {
    const edit = this.document.redo();
    this.say(edit ? `Done again: ${edit.label}` : "There is nothing to do again.");
  }

  /** The document has changed, or was saved. */
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
    for (const part of this.parts) part.close?.();
    this.document.removeEventListener("change", this.changed);
    this.document.removeEventListener("saved", this.changed);
    this.canvas.close();
    $("ed-page").replaceChildren();
  }
}

/** Ask whether unsaved work is to be lost; `save` saves it, or is null. Returns whether to go on. */
export async function mayLeave(names, save) {
  const answer = await ask(
    "Leave without saving?",
    h("p", { text: `Not saved: ${names.join(", ")}.` }),
    [
      ["Stay", ""],
      ["Leave without saving", "leave", "danger"],
      ...(save ? [["Save and leave", "save", "primary"]] : []),
    ],
  );
  if (answer === "save") return save();
  announce(answer === "leave" ? "Left without saving" : "");
  return answer === "leave";
}
