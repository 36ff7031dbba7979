// The rows of a policy that the optimiser proposes, next to those of the plan.

import { h, plural } from "../dom.js";
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
        h(
          "table.ed-policy",
          h(
            "thead",
            h(
              "tr",
              ["Marking", "Now", "Proposed", "Take"].map((text) => h("th", { scope: "col", text })),
            ),
          ),
          h(
            "tbody",
            rows.map((row) => {
              const now = same ? this.present(row.marking) : null;
              return h(
                "tr",
                h("td", markingText(places, row.marking)),
                h("td", now ? choiceText(now.choose) : "no such row"),
                h(
                  "td",
                  Object.keys(row.choose).length ? choiceText(row.choose) : "wait",
                  " ",
                  row.differs === true && h("span.badge.warn", "differs"),
                ),
                h(
                  "td",
                  this.panel.button(
                    `take ${row.number}`,
                    "Take over",
                    () => this.take(places, [row]),
                    {
                      "aria-label": `Take over the proposed row ${row.number}`,
                    },
                  ),
                ),
              );
            }),
          ),
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
    return this.panel.policy.rows.find(
      (row) => row.marking.map(String).join() === marking.map(String).join(),
    );
  }

  /** Take over proposed rows: each replaces the row of the same marking, or is inserted before those with more
   * wildcards. */
  take(places, taken) {
    const unknown = [...new Set(taken.flatMap(({ choose }) => Object.keys(choose)))].find(
      (name) => !this.panel.immediate.includes(name),
    );
    if (unknown !== undefined) {
      this.panel.mode.say(`The net here has no immediate transition '${unknown}' any more.`);
      return;
    }
    let { policy } = this.panel;
    const missing = places.filter((name) => !policy.places.includes(name));
    if (missing.some((name) => !NAMES.places(this.panel.state).includes(name))) {
      this.panel.mode.say(`The net here has no place '${missing[0]}' any more.`);
      return;
    }
    policy = {
      ...policy,
      places: [...policy.places, ...missing],
      rows: policy.rows.map((row) => ({
        ...row,
        marking: [...row.marking, ...missing.map(() => "-")],
      })),
    };
    for (const { marking, choose } of taken) {
      const cells = policy.places.map((name) =>
        places.includes(name) ? marking[places.indexOf(name)] : "-",
      );
      const key = cells.map(String).join();
      const at = policy.rows.findIndex((row) => row.marking.map(String).join() === key);
      const row = { marking: cells, choose };
      policy.rows =
        at < 0
          ? [...policy.rows, row]
          : policy.rows.map((it, i) => (i === at ? { ...it, choose } : it));
    }
    this.panel.drafts.clear();
    this.panel.put(
      this.panel.lens(),
      policy,
      taken.length === 1 ? "Take over a proposed row" : "Take over the proposed policy",
    );
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
      this.panel.drafts.clear();
      this.panel.put(
        this.panel.lens(),
        {
          ...this.panel.policy,
          places: page.places,
          rows: rows.map(({ marking, choose }) => ({ marking, choose })),
        },
        "Take over the proposed policy",
      );
    } catch (error) {
      this.panel.mode.say(error.message);
    }
  }
}

const markingText = (places, marking) =>
  places
    .map((name, i) => [name, marking[i]])
    .filter(([, cell]) => cell !== "-")
    .map(([name, cell]) => `${name}: ${cell}`)
    .join(", ") || "any marking";
