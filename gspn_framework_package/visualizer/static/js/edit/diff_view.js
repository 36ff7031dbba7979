// The visual difference of two documents: on the drawing, added elements are green, changed ones amber, removed ones
// red ghosts; a list shows all changes.

import { $, h, s, plural } from "../dom.js";
import { post } from "../api.js";

const QUIET = 250; // ms without an edit after which the difference is computed again
const LISTED = 400;
const SIGNS = { added: "+", removed: "−", changed: "~" };
const CLASSES = ["diff-added", "diff-changed"];

const said = (value) => {
  const text = typeof value === "string" ? value : JSON.stringify(value);
  return text.length > 140 ? `${text.slice(0, 100)} … ${text.slice(-30)}` : text;
};

/** One change in words. */
function inWords({ what, kind, name, key, from, to }) {
  const noun = { row: "policy row", setting: "" }[kind] ?? kind;
  if (kind === "order") return `the order of the ${name}`;
  const shown = kind === "arc" ? name.replace(">", " → ") : name;
  const subject = `${noun} ${shown}${key ? `, ${key}` : ""}`.trim();
  if (what === "changed") return `${subject}: ${said(from)} → ${said(to)}`;
  const value = what === "added" ? to : from;
  if (kind === "row") return `${subject}: ${said(value.choose ?? {})}`;
  return kind === "place" || kind === "transition" || kind === "arc" || value === null
    ? subject
    : `${subject}: ${said(value)}`;
}

/** The list of changes; `choose(change)`, if given, is called when a change is clicked. */
export function changeList(changes, choose = null) {
  const items = changes.slice(0, LISTED).map((change) => {
    const text = `${SIGNS[change.what]} ${inWords(change)}`;
    const can = choose && ["place", "transition", "arc", "action"].includes(change.kind);
    return h(
      "li",
      { class: `diff-${change.what}` },

      can ? h("button.link", { text, onclick: () => choose(change) }) : text,
    );
  });
  if (changes.length > LISTED) items.push(h("li.muted", `and ${changes.length - LISTED} more`));
  return changes.length ? h("ul.ed-changes", items) : h("p.muted", "There are no differences.");
}

/** The changes from one document to another, computed by the server. */
export async function changesBetween(mode, from, to) {
  const { changes } = await post("edit/diff", { from, to }, { id: mode.id });
  return changes || [];
}

/** `mode.diff`. */
export class DiffView {
  constructor(mode) {
    this.mode = mode;
    mode.diff = this;
    this.shown = null; // {title, from, to}; `to` is null for the present state
    this.ghosts = s("g.diff-ghosts");
    this.asked = 0;
    this.body = h("div", { id: "ed-changes" });
    this.title = h("h2", { id: "ed-diff-title" });
    this.closeButton = h("button", { text: "Hide the changes", onclick: () => this.hide() });
    mode.panel(
      "diff",
      "Changes",
      h(
        "div",
        h(
          "div.buttons",
          h("button", {
            id: "ed-diff-unsaved",
            text: "Not saved",
            title: "What has changed since the plan was opened or saved",
            onclick: () => this.showUnsaved(),
          }),
          h("button", {
            id: "ed-diff-running",
            text: "Against what runs",
            title: "Differences from the plan that is open in the page, which its run uses",
            onclick: () => this.show({ title: "Against what runs", from: "running" }),
          }),
          this.closeButton,
        ),
        this.title,
        this.body,
      ),
    );
    mode.button("look", {
      id: "ed-diff",
      label: "Changes",
      title: "What has changed since the plan was opened or saved",
      onclick: () => this.showUnsaved(),
    });
    this.hide();
    mode.onDocument(() => this.later(), "change", "saved");
  }

  showUnsaved() {
    return this.show({ title: "Not saved", from: () => this.mode.document.saved });
  }

  /** Show the changes. `from`: a document, a function that returns one, "saved" or "running"; `to`: a document;
   * if absent, the present one, including later edits. */
  show({ title, from, to = null }) {
    this.shown = { title, from, to };
    this.mode.showPanel("diff");
    return this.update();
  }

  hide() {
    this.shown = null;
    this.asked += 1;
    this.clear();
    this.title.textContent = "";
    this.closeButton.hidden = true;
    this.body.replaceChildren(h("p.muted", "Changes are drawn in place: green, amber and red."));
  }

  later() {
    if (!this.shown) return;
    this.asked += 1; // the changes shown are out of date
    this.title.textContent = `${this.shown.title} …`;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.update(), QUIET);
  }

  async update() {
    if (!this.shown) return;
    const { title, from, to } = this.shown;
    this.asked += 1;
    const { asked } = this;
    this.title.textContent = `${title} …`;
    this.closeButton.hidden = false;
    const old = typeof from === "function" ? from() : from;
    try {
      const changes = await changesBetween(this.mode, old, to || this.mode.document.state);
      if (asked !== this.asked) return;
      this.title.textContent = `${title}: ${plural(changes.length, "change")}`;
      this.body.replaceChildren(changeList(changes, (change) => this.go(change)));
      this.draw(changes);
    } catch (error) {
      if (asked !== this.asked) return;
      this.clear();
      this.title.textContent = `${title}: not known`;
      this.body.replaceChildren(h("p", `${error.message}.`));
    }
  }

  /** The key of the element that a change is at. */
  keyOf({ kind, name }) {
    if (kind === "action") return `place:${name}`;
    return ["place", "transition", "arc"].includes(kind) ? `${kind}:${name}` : null;
  }

  go(change) {
    const key = this.keyOf(change);
    this.mode.choose([key]);
    if (this.mode.selection.has(key)) this.mode.canvas.flyTo(key);
  }

  clear() {
    for (const name of CLASSES)
      for (const element of $("ed-net").querySelectorAll(`.${name}`))
        element.classList.remove(name);
    this.ghosts.replaceChildren();
    this.ghosts.remove();
  }

  draw(changes) {
    this.clear();
    const { canvas } = this.mode;
    const spots = new Map(canvas.nodes.map((node) => [node.name, [node.x, node.y]]));
    const removed = changes.filter(({ what }) => what === "removed");
    const shape = (kind, [x, y]) =>
      kind === "place"
        ? s("circle", { cx: x, cy: y, r: 20 })
        : s("rect", { x: x - 7, y: y - 20, width: 14, height: 40 });
    for (const { kind, name, from } of removed) {
      if ((kind !== "place" && kind !== "transition") || !from?.position) continue;
      const spot = canvas.positionOf(from);
      if (!spots.has(name)) spots.set(name, spot);
      this.ghosts.append(
        shape(kind, spot),
        s("text", { x: spot[0], y: spot[1] + 34, text: name, "text-anchor": "middle" }),
      );
    }
    for (const { kind, from } of removed) {
      if (kind !== "arc" || !spots.has(from.from) || !spots.has(from.to)) continue;
      const [[x1, y1], [x2, y2]] = [spots.get(from.from), spots.get(from.to)];
      this.ghosts.prepend(s("line", { x1, y1, x2, y2 }));
    }
    for (const change of changes) {
      const key = this.keyOf(change);
      if (!key || (change.what === "removed" && change.kind !== "action")) continue;
      const added = change.what === "added" && change.kind !== "action";
      for (const element of canvas.elementsOf(key))
        element.classList.add(added ? "diff-added" : "diff-changed");
    }
    canvas.layer.over.append(this.ghosts);
  }

  close() {
    this.asked += 1;
    clearTimeout(this.timer);
  }
}
