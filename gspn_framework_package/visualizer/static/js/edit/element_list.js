// The list next to the drawing: the places, transitions and arcs of the document, searchable. It shows and changes the
// selection; from here, keys can do everything that the pointer does on the drawing.

import { h, $, natural, textField, LIST_STEPS } from "../dom.js";
import { RestingList } from "../resting_list.js";
import { arcKey, nodeKey } from "./net_edits.js";

const ROWS_DRAWN = 150; // more are found by searching
const PAUSE = 120; // ms between two drawings

export class ElementList extends RestingList {
  constructor(mode) {
    const list = h("ul.node-list", {
      id: "ed-list",
      role: "listbox",
      tabindex: "0",
      "aria-multiselectable": "true",
      "aria-label": "Places, transitions and arcs",
    });
    super(list, PAUSE);
    this.mode = mode;
    this.rows = new Map(); // key -> the row drawn for it
    this.at = null; // key of the element with the keyboard focus
    this.made = 0; // number of rows made so far, for unique ids
    this.listed = null; // the state of the document whose elements `all` contains
    this.all = [];
    this.items = [];
    this.search = textField({
      id: "ed-search",
      type: "search",
      placeholder: "Search  ( / )",
      "aria-label": "Search the elements of the net",
      oninput: () => this.update(),
      onkeydown: (event) => {
        if (event.key === "ArrowDown" || event.key === "Enter") {
          event.preventDefault();
          if (this.items.length) this.choose(this.items[0].key);
          this.list.focus();
        } else if (event.key === "Escape") {
          this.search.value = "";
          this.update();
          this.list.focus();
        }
      },
    });
    list.onkeydown = (event) => this.key(event);
    list.onclick = (event) => {
      const row = event.target.closest("li[data-key]");
      if (row) this.choose(row.dataset.key, event.shiftKey || event.ctrlKey || event.metaKey);
    };
    $("ed-list-box").append(h("div.find", this.search), list);
    mode.onDocument(({ detail }) => {
      if (detail.before.net !== mode.document.net || detail.before.plan !== mode.document.plan)
        this.later();
    }, "change");
    mode.addEventListener("select", () => {
      this.at = [...mode.selection].pop() ?? null;
      this.mark();
    });
    this.update();
  }

  /** All elements of the document, as [[title, items in the order of their names], ...]. */
  elements() {
    const { state } = this.mode.document;
    if (this.listed === state) return this.all;
    const { net } = (this.listed = state);
    const { canvas } = this.mode;
    const boxes = [...canvas.groups].map(([title, nodes]) => ({
      key: `group:${title}`,
      name: title,
      sign: "group",
      says: `, group of ${nodes.length}`,
    }));
    const places = net.places.map((place) => ({
      key: nodeKey("place", place.name),
      name: place.name,
      sign: canvas.classOf("place", place) === "resource" ? "resource" : "place",
      says: `, place, ${place.tokens || 0} tokens`,
      count: place.tokens,
    }));
    const transitions = net.transitions.map((t) => ({
      key: nodeKey("transition", t.name),
      name: t.name,
      sign: t.timed ? "timed" : "immediate",
      says: `, ${t.timed ? "timed" : "immediate"} transition`,
    }));
    const arcs = net.arcs.map((arc) => ({
      key: arcKey(arc),
      name: `${arc.from} → ${arc.to}`,
      sign: arc.inhibitor ? "arc-sign inhibits" : "arc-sign",
      says: arc.inhibitor ? ", inhibitor arc" : ", arc",
      count: (arc.weight ?? 1) === 1 ? undefined : arc.weight,
    }));
    const titled = { Groups: boxes, Places: places, Transitions: transitions, Arcs: arcs };
    this.all = Object.entries(titled);
    for (const [, items] of this.all) items.sort((a, b) => natural(a.name, b.name));
    return this.all;
  }

  draw() {
    const wanted = this.search.value.trim().toLowerCase();
    const groups = this.elements().map(([title, items]) => [
      title,
      wanted ? items.filter(({ name }) => name.toLowerCase().includes(wanted)) : items,
    ]);
    this.items = groups.flatMap(([, items]) => items);
    // the first ones, or those around the focused one
    const at = this.items.findIndex(({ key }) => key === (this.mode.arcEnd ?? this.at));
    const first = at < ROWS_DRAWN ? 0 : at - ROWS_DRAWN / 2;
    const before = this.rows;
    const wantedRows = [];
    this.rows = new Map();
    const heading = (text) => wantedRows.push(h("li.heading", { role: "presentation", text }));
    let start = 0; // number of the first item of the group
    for (const [title, items] of groups) {
      if (!items.length) continue;
      const within = (n) => Math.min(items.length, Math.max(0, n - start));
      const [from, to] = [within(first), within(first + ROWS_DRAWN)];
      heading(`${title} (${items.length})`);
      if (from) heading(`${from} before: search`);
      for (const item of items.slice(from, to)) {
        const row = this.rows.has(item.key) ? this.row(item) : this.row(item, before.get(item.key));
        this.rows.set(item.key, row);
        wantedRows.push(row);
      }
      if (to < items.length && from < items.length) heading(`${items.length - to} more: search`);
      start += items.length;
    }
    if (!this.items.length) {
      const text = wanted ? "No match" : "The net is empty"; // a list box needs an option
      wantedRows.push(h("li.heading", { role: "option", "aria-disabled": "true", text }));
    }
    this.put(wantedRows);
    this.mark();
  }

  /** Show these rows in the list; rows already in it stay in place. */
  put(rows) {
    const stays = new Set(rows);
    for (const row of [...this.list.children]) if (!stays.has(row)) row.remove();
    let at = this.list.firstChild;
    for (const row of rows)
      if (row === at) at = at.nextSibling;
      else this.list.insertBefore(row, at);
  }

  /** The row of an element: the existing one if it is up to date. */
  row(item, before = null) {
    const shows = JSON.stringify(item);
    if (before?.shows === shows) return before;
    const row = h(
      "li",
      {
        role: "option",
        id: `ed-row-${++this.made}`,
        "data-key": item.key,
        title: item.name,
        "aria-selected": "false",
      },
      h("span", { class: `sign ${item.sign}`, "aria-hidden": "true" }),
      h("span.name", item.name),
      h("span.unseen", item.says),
      item.count > 0 && h("span.tokens", { "aria-hidden": "true", text: item.count }),
    );
    row.shows = shows;
    return row;
  }

  key(event) {
    const { tool, arcEnd, selection } = this.mode;
    const step = LIST_STEPS[event.key];
    const aims = tool === "arc" && this.mode.arcStart;
    const toggles = event.key === " " && !aims;
    if (!(step || toggles) || event.altKey || !this.items.length) return;
    event.preventDefault();
    event.stopPropagation();
    const present = this.items.findIndex(({ key }) => key === ((aims && arcEnd) || this.at));
    if (toggles) {
      if (present < 0) return;
      const { key } = this.items[present];
      const keys = this.mode.canvas.keysOf(key);
      const others = [...selection].filter((it) => !keys.includes(it));
      this.mode.choose(keys.every((it) => selection.has(it)) ? others : [...others, ...keys]);
      this.goTo(key);
      return;
    }
    const next = present < 0 ? 0 : Math.min(this.items.length - 1, Math.max(0, present + step));
    const { key } = this.items[next];
    if ((event.ctrlKey || event.metaKey) && !aims) this.goTo(key);
    else this.choose(key, event.shiftKey);
  }

  /** Move the keyboard focus to an element without selecting it. */
  goTo(key) {
    this.at = key;
    this.mark();
  }

  /** Select an element; while an arc is being made, make it the arc's end. */
  choose(key, more = false) {
    const { mode } = this;
    if (mode.tool === "arc" && mode.arcStart) {
      mode.aim(key);
      return;
    }
    const keys = mode.canvas.keysOf(key);
    mode.choose(more ? [...mode.selection, ...keys] : keys);
    mode.canvas.flyTo(keys[0]);
    this.goTo(key);
  }

  mark() {
    const { selection, arcEnd } = this.mode;
    for (const row of this.list.querySelectorAll("[aria-selected=true]"))
      row.setAttribute("aria-selected", "false");
    const group = `group:${this.mode.canvas.group}`;
    for (const key of [...selection, group])
      this.rows.get(key)?.setAttribute("aria-selected", "true");
    this.list.querySelector(".at")?.classList.remove("at");
    const at = arcEnd || this.at;
    const row = this.rows.get(at);
    if (!row) {
      this.list.removeAttribute("aria-activedescendant");
      if (this.items.some(({ key }) => key === at)) this.update(); // not drawn yet
      return;
    }
    if (arcEnd) row.setAttribute("aria-selected", "true");
    else if (!selection.has(at)) row.classList.add("at");
    this.showRow(row);
  }
}
