// The rows of a policy that the optimiser proposes, next to those of the plan.

import { columns, h, plural, table } from "../dom.js";
import { get } from "../api.js";
import { choiceText } from "../policy_table.js";
import { NAMES } from "./names.js";

const ROWS = 20; // on one page of the table

/** A part of the panel of the policy. */
export class ProposedRows {
  constructor(panel) {
    this.panel = panel;
    this.found = null; // {text}, or {job, start, places, rows, total, changed}
  }

  content() {
    const shown = this.found;
    return [
      h(
        "p.muted",
        "Compare the rows here with a policy computed for the file on the Optimise tab.",
      ),
      this.panel.button("policy look", "Look for a computed policy", () => this.look()),
      h("div", { role: "status" }, shown && (shown.text ? h("p", shown.text) : this.rows(shown))),
    ];
  }

  async look(start = 0) {
    try {
      const { job } = await get("optimised", { id: this.panel.mode.id });
      if (!job) this.found = { text: "No policy has been computed for this file yet." };
      else {
        const page = await get(`analysis/${job}/rows`, { from: start, limit: ROWS });
        this.found = { job, start, ...page };
      }
    } catch (error) {
      this.found = { text: error.message };
    }
    this.panel.refresh();
  }

  rows({ places, rows, total, changed, start }) {
    const same = places.join("\n") === this.panel.policy.places.join("\n");
    return [
      h("p.muted", `${changed} of ${plural(total, "row")} choose differently; they come first.`),
      h(
        "div.scroll",
        { tabindex: "0", role: "region", "aria-label": "Proposed rows" },
        table(
          "table.ed-policy",
          columns(["Marking", "Now", "Proposed", "Take"]),
          rows.map((row) => {
            const now = same ? this.present(row.marking) : null;
            const about = { "aria-label": `Take over the proposed row ${row.number}` };
            const take = () => this.take(places, row);
            return [
              markingText(places, row.marking),
              now ? choiceText(now.choose) : "no such row",
              [choiceText(row.choose), " ", row.differs && h("span.badge.warn", "differs")],
              this.panel.button(`take ${row.number}`, "Take over", take, about),
            ].map((cell) => h("td", cell));
          }),
        ),
      ),
      h(
        "div.buttons",
        this.panel.button("take all", "Take over the whole policy", () => this.takeAll()),
        start > 0 &&
          this.panel.button("proposed earlier", "Earlier rows", () => this.look(start - ROWS)),
        start + rows.length < total &&
          this.panel.button("proposed later", "More rows", () => this.look(start + ROWS)),
      ),
    ];
  }

  present(marking) {
    return this.panel.policy.rows.find((row) => sameMarking(row.marking, marking));
  }

  /** Take over a proposed row: it replaces the row of the same marking, or comes last. */
  take(places, { marking, choose }) {
    const { panel } = this;
    const { policy } = panel;
    const unknown = Object.keys(choose).find((name) => !panel.immediate.includes(name));
    if (unknown !== undefined) {
      panel.mode.say(`The net here has no immediate transition '${unknown}' any more.`);
      return;
    }
    const missing = places.filter((name) => !policy.places.includes(name));
    if (missing.some((name) => !NAMES.places(panel.state).includes(name))) {
      panel.mode.say(`The net here has no place '${missing[0]}' any more.`);
      return;
    }
    const columnsNow = [...policy.places, ...missing];
    const rows = policy.rows.map((row) => ({
      ...row,
      marking: [...row.marking, ...missing.map(() => "-")],
    }));
    const cells = columnsNow.map((name) =>
      places.includes(name) ? marking[places.indexOf(name)] : "-",
    );
    const at = rows.findIndex((row) => sameMarking(row.marking, cells));
    if (at < 0) rows.push({ marking: cells, choose });
    else rows[at] = { ...rows[at], choose };
    this.put({ ...policy, places: columnsNow, rows }, "Take over a proposed row");
  }

  put(policy, label) {
    this.panel.drafts.clear();
    this.panel.put(this.panel.lens(), policy, label);
  }

  async takeAll() {
    try {
      const { job } = this.found;
      const rows = [];
      let page;
      do {
        page = await get(`analysis/${job}/rows`, { from: rows.length, limit: 500 });
        rows.push(...page.rows);
      } while (page.rows.length && rows.length < page.total);
      rows.sort((a, b) => a.number - b.number);
      const names = new Set(NAMES.places(this.panel.state));
      const foreign = page.places.find((name) => !names.has(name));
      const unknown = rows
        .flatMap(({ choose }) => Object.keys(choose))
        .find((it) => !this.panel.immediate.includes(it));
      if (foreign ?? unknown) {
        this.panel.mode.say(`The net here has no '${foreign ?? unknown}' any more.`);
        return;
      }
      const taken = rows.map(({ marking, choose }) => ({ marking, choose }));
      const policy = { ...this.panel.policy, places: page.places, rows: taken };
      this.put(policy, "Take over the proposed policy");
    } catch (error) {
      this.panel.mode.say(error.message);
    }
  }
}

const sameMarking = (one, other) => one.map(String).join() === other.map(String).join();

const markingText = (places, marking) =>
  places
    .map((name, i) => [name, marking[i]])
    .filter(([, cell]) => cell !== "-")
    .map(([name, cell]) => `${name}: ${cell}`)
    .join(", ") || "any marking";
