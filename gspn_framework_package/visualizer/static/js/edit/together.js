// Who else edits the plan: what they have selected and where their pointers are, and what both changed.

import { $, h, s, plural } from "../dom.js";
import { post } from "../api.js";
import { at as spot } from "../net_nodes.js";
import { conflictText, merged, placeOf } from "./merge.js";

const AGAIN = 1000; // ms before another attempt to reach the server
const SILENCE = 10_000; // ms without even a ping after which the stream is considered dead
const MOVED = 200; // ms between reports of the pointer
const SHOWN = 2500; // ms during which somebody else's change is marked
const LISTED = 12;
const COLOURS = 5; // in the style sheet

const colour = (number) => `editor-${(number - 1) % COLOURS}`;

/** `mode.together`. */
export class Together {
  constructor(mode) {
    this.mode = mode;
    mode.together = this;
    this.others = []; // [{page, number, selection, at}]
    this.timer = 0;
    this.sign = s("g.ed-others");
    mode.canvas.layer.over.append(this.sign);
    this.who = h("span.muted", { id: "ed-others", role: "status" });
    this.both = h("div.ed-both", { id: "ed-both", hidden: true });
    $("ed-foot").append(this.who);
    $("ed-frame").before(this.both);
    const { signal } = mode.bound;
    mode.addEventListener("select", () => this.later(), { signal });
    mode.canvas.container.addEventListener("pointermove", () => this.later(), { signal });
    mode.onDocument(() => this.draw(), "change");
    addEventListener("online", () => this.broke(this.source), { signal });
    this.open();
  }

  // -- the server ------------------------------------------------------------------------------------

  open() {
    if (this.closed) return;
    const query = new URLSearchParams({ id: this.mode.id, page: this.mode.visit });
    const source = new EventSource(`/api/edit/stream?${query}`);
    this.source = source;
    const alive = () => {
      clearTimeout(this.silence);
      this.silence = setTimeout(() => this.broke(source), SILENCE);
    };
    alive();
    source.addEventListener("ping", alive);
    source.onmessage = (message) => {
      alive();
      this.hear(JSON.parse(message.data));
    };
    source.onerror = () => this.broke(source);
  }

  broke(source) {
    if (this.closed || source !== this.source) return;
    clearTimeout(this.silence);
    source.close();
    this.source = null;
    setTimeout(() => this.again(), AGAIN);
  }

  /** The stream broke or was refused: ask once, and try it again. */
  async again() {
    if (this.closed) return;
    try {
      this.hear(await this.report());
      this.mode.files.keepDraft(); // what was edited while the server did not answer
    } catch {
      this.who.textContent =
        "The server does not answer. Your changes are kept here until it does.";
    }
    this.open();
  }

  /** Say what is selected here. Resolves to the version, and who edits the plan. */
  report() {
    const { here } = this.mode.pointer;
    return post(
      "edit/here",
      { page: this.mode.visit, selection: [...this.mode.selection], at: here && [...here] },
      { id: this.mode.id },
    );
  }

  later() {
    if (this.timer || !this.others.length) return;
    this.timer = setTimeout(() => {
      this.timer = 0;
      if (!this.closed) this.report().catch(() => {}); // the stream's error says so
    }, MOVED);
  }

  hear({ version, editors }) {
    if (this.closed) return;
    const alone = !this.others.length;
    this.others = editors.filter(({ page }) => page !== this.mode.visit);
    const names = this.others.map(({ number }) => `Editor ${number}`);
    this.who.textContent = names.length ? `Also here: ${names.join(", ")}` : "";
    this.draw();
    if (alone && names.length) {
      this.later();
      this.mode.files.later();
    }
    const { files, opened } = this.mode;
    if (version && version !== opened.version && !(files.draft && version === files.draft.version))
      files.follow().catch(() => {}); // the next message repeats it
  }

  // -- what is shown ---------------------------------------------------------------------------------

  draw() {
    const { byKey } = this.mode.canvas;
    this.sign.replaceChildren(
      ...this.others.flatMap(({ number, selection, at }) => {
        const nodes = selection.map((key) => byKey.get(key)).filter(Boolean);
        const name = (x, y) => s("text", { x, y, text: `Editor ${number}` });
        const marks = nodes.map(({ x, y }) => s("circle", { cx: x, cy: y, r: 27 }));
        if (at)
          marks.push(
            s("path", { d: "M0 0L4 12L6.5 7.5L11 6Z", transform: spot({ x: at[0], y: at[1] }) }),
            name(at[0] + 12, at[1] + 18),
          );
        else if (nodes.length) marks.push(name(nodes[0].x + 26, nodes[0].y - 22));
        return s("g", { class: colour(number) }, marks);
      }),
    );
  }

  /** Somebody else's changes were merged: mark them, and list what both changed. */
  tell({ base, mine, theirs, state, conflicts, taken }) {
    const elements = taken.filter(([kind]) => ["place", "transition", "arc"].includes(kind));
    const keys = elements.map(([kind, name]) => `${kind}:${name.replace(" → ", ">")}`);
    for (const element of keys.flatMap((key) => this.mode.canvas.elementsOf(key))) {
      element.classList.add("followed");
      setTimeout(() => element.classList.remove("followed"), SHOWN);
    }
    const names = [...new Set(taken.map(([kind, name]) => `${kind} ${name ?? ""}`.trim()))];
    if (names.length) {
      const more = names.length > 5 ? `, and ${names.length - 5} more` : "";
      this.mode.say(`Changed by somebody else: ${names.slice(0, 5).join(", ")}${more}.`);
    }
    if (conflicts.length) this.showConflicts({ base, mine, theirs, state, conflicts });
  }

  showConflicts({ base, mine, theirs, state, conflicts }) {
    const hide = () => {
      this.both.hidden = true;
      this.both.replaceChildren();
    };
    const take = (conflict, item) => {
      const prefer = new Set([placeOf(conflict)]);
      const chosen = merged(base, mine, theirs, { prefer }).state;
      this.mode.document.edit("Take theirs", (now) => merged(state, now, chosen, { prefer }).state);
      item.remove();
      if (!this.both.querySelector("li")) hide();
    };
    const items = conflicts.slice(0, LISTED).map((conflict) => {
      const button = h("button", {
        text: "Take theirs",
        "aria-label": `Take theirs: ${conflictText(conflict)}`,
        onclick: () => take(conflict, item),
      });
      const choice = conflict.mine !== undefined && conflict.theirs !== undefined; // what one removed stays
      const item = h("li", conflictText(conflict), " ", choice && button);
      return item;
    });
    this.both.replaceChildren(
      h(
        "strong",
        `Both of you changed ${plural(conflicts.length, "thing")}; yours stays unless you take theirs:`,
      ),
      h("ul", items, conflicts.length > LISTED && h("li", `and ${conflicts.length - LISTED} more`)),
      h("button", {
        text: "Close",
        "aria-label": "Close the list of what both changed",
        onclick: hide,
      }),
    );
    this.both.hidden = false;
  }

  close() {
    this.closed = true;
    clearTimeout(this.timer);
    clearTimeout(this.silence);
    this.source?.close();
    post("edit/here", { page: this.mode.visit, gone: true }, { id: this.mode.id }).catch(() => {});
  }
}
