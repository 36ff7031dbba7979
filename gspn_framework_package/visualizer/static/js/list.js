// The list on the left: places and transitions, enabled ones first, searchable. Only the visible part is drawn.

import { h, $, natural, LIST_STEPS } from "./dom.js";
import { RestingList } from "./resting_list.js";

const ROWS_DRAWN = 150; // more are found by searching
const PAUSE = 250; // ms between two drawings

/** Fires "choose" (detail {kind, index}) and "fire" (detail index, Shift+Enter). */
export class NodeList extends RestingList {
  constructor(model) {
    super($("list"), PAUSE);
    this.model = model;
    this.search = $("list-search");
    this.search.value = "";
    this.chosen = null;
    const { scene } = model;
    const inOrder = (items) => items.sort((a, b) => natural(a.name, b.name));
    this.transitions = inOrder(
      scene.transitions.map((t, index) => ({
        kind: "transition",
        index,
        key: `t${index}`,
        name: t.name,
        sign: t.timed ? "timed" : "immediate",
      })),
    );
    this.places = inOrder(
      scene.places.map((p, index) => ({
        kind: "place",
        index,
        key: `p${index}`,
        name: p.name,
        sign: p.kind === "resource" ? "resource" : "place",
      })),
    );
    this.search.oninput = () => this.update();
    this.search.onkeydown = (event) => {
      if (event.key === "ArrowDown" || event.key === "Enter") {
        event.preventDefault();
        if (event.key === "Enter") this.move(0, true);
        this.list.focus();
      } else if (event.key === "Escape") {
        this.search.value = "";
        this.update();
        this.search.blur();
      }
    };
    this.list.onkeydown = (event) => {
      const steps = LIST_STEPS[event.key];
      if (steps) {
        event.preventDefault();
        event.stopPropagation();
        this.move(steps, true);
      } else if (event.key === "Enter") {
        event.preventDefault();
        if (event.shiftKey && this.chosen?.kind === "transition")
          this.dispatchEvent(new CustomEvent("fire", { detail: this.chosen.index }));
        else this.move(0, true);
      }
    };
    this.list.onclick = (event) => {
      const row = event.target.closest("li[data-key]");
      if (row)
        this.choose(
          this.items.find((item) => item.key === row.dataset.key),
          true,
        );
    };
    this.update();
  }

  draw() {
    const { board } = this.model;
    if (!board) return;
    const wanted = this.search.value.trim().toLowerCase();
    const match = (name) => !wanted || name.toLowerCase().includes(wanted);
    const enabled = this.transitions.filter((t) => board.enabled.has(t.index) && match(t.name));
    const others = this.transitions.filter((t) => !board.enabled.has(t.index) && match(t.name));
    const marked = this.places.filter((p) => match(p.name));
    marked.sort((a, b) => (board.marking[b.index] > 0) - (board.marking[a.index] > 0));
    const groups = [
      [`Enabled (${enabled.length})`, enabled, true],
      [`Places (${marked.length})`, marked],
      [`Not enabled (${others.length})`, others],
    ];
    this.items = groups.flatMap(([, items]) => items);
    let left = ROWS_DRAWN;
    const rows = [];
    const heading = (text) => rows.push(h("li.heading", { role: "presentation", text }));
    for (const [title, items, on] of groups) {
      if (!items.length) continue;
      heading(title);
      for (const item of items.slice(0, Math.max(0, left))) rows.push(this.row(item, on));
      if (items.length > left) heading(`${items.length - Math.max(0, left)} more: search`);
      left -= items.length;
    }
    if (!this.items.length) heading(wanted ? "No match" : "The net is empty");
    this.list.replaceChildren(...rows);
    this.mark();
  }

  row(item, enabled) {
    const tokens = item.kind === "place" ? this.model.board.marking[item.index] : 0;
    const kind =
      item.kind === "place"
        ? `, ${item.sign === "resource" ? "resource place" : "place"}`
        : `, ${item.sign} transition${enabled ? ", enabled" : ""}`;
    const unseen = (text) => h("span.unseen", text);
    return h(
      "li",
      {
        role: "option",
        id: `list-${item.key}`,
        "data-key": item.key,
        class: enabled ? "enabled" : "",
        title: item.name,
      },
      h("span", { class: `sign ${item.sign}`, "aria-hidden": "true" }),
      h("span.name", item.name),
      unseen(kind),
      tokens > 0 &&
        h("span.tokens", unseen(", "), String(tokens), unseen(tokens === 1 ? " token" : " tokens")),
    );
  }

  move(steps, fly) {
    if (!this.items.length) return;
    const { kind, index } = this.chosen || {};
    const at = this.items.findIndex((item) => item.kind === kind && item.index === index);
    const next = at < 0 ? 0 : Math.min(this.items.length - 1, Math.max(0, at + steps));
    this.choose(this.items[next], fly);
  }

  choose(item, fly) {
    this.dispatchEvent(
      new CustomEvent("choose", { detail: { kind: item.kind, index: item.index, fly } }),
    );
  }

  select(selection) {
    this.chosen = selection;
    this.mark();
  }

  mark() {
    for (const row of this.list.querySelectorAll("[aria-selected]"))
      row.removeAttribute("aria-selected");
    this.list.removeAttribute("aria-activedescendant");
    if (!this.chosen) return;
    const row = document.getElementById(`list-${this.chosen.kind[0]}${this.chosen.index}`);
    if (!row) return;
    row.setAttribute("aria-selected", "true");
    this.showRow(row);
  }
}
