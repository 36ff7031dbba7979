// The rows of a computed policy, one page at a time; those that differ from the present policy come first.

import { h, attempt, table, rounded } from "./dom.js";
import { get } from "./api.js";

const ROWS = 50;

/** What a policy chooses, in words. */
export function choiceText(choices) {
  const chosen = Object.entries(choices);
  if (!chosen.length) return "wait";
  return chosen
    .map(([name, probability]) => (chosen.length > 1 ? `${name} ${percent(probability)}` : name))
    .join(", ");
}

export const percent = (probability) => `${rounded(100 * probability, 4)} %`;

/** The marking of a row as {place: count}, without the places that may hold any number. */
function markingOf(places, cells) {
  return Object.fromEntries(
    places.map((place, i) => [place, cells[i]]).filter(([, count]) => count !== "-"),
  );
}

function markingText(marking) {
  const [some, none] = [[], []];
  for (const [place, count] of Object.entries(marking))
    if (Number(count) !== 0) some.push(`${place}: ${count}`);
    else none.push(place);
  if (none.length) some.push(`none in ${none.join(", ")}`);
  return some.join("; ") || "any marking";
}

export class PolicyTable {
  /** `job`: key of the analysis. `paint(marking, choices, title)` highlights a row on the net. */
  constructor(job, paint) {
    this.job = job;
    this.paint = paint;
    this.position = h("span.muted", { role: "status" });
    const step = (text, by) =>
      h("button", { text, onclick: () => this.show(this.start + by * ROWS) });
    [this.back, this.on] = [step("Earlier rows", -1), step("More rows", 1)];
    this.says = h("p.muted");
    const rows = table(
      "table.policy",
      ["Row", "Marking", "Choice"].map((text) => h("th", text)),
      [],
    );
    this.body = rows.lastChild;
    this.element = h("div", this.says, rows, h("div.buttons", this.back, this.on, this.position));
  }

  async show(start = 0) {
    const page = await attempt(() =>
      get(`analysis/${this.job}/rows`, { from: Math.max(0, start), limit: ROWS }),
    );
    if (!page) return;
    this.start = Math.max(0, start);
    const end = this.start + page.rows.length;
    const [changed, total] = [page.changed, page.total].map((n) => n.toLocaleString("en"));
    this.says.textContent =
      `${changed} of ${total} rows choose differently in a marking listed above; they come first. ` +
      "A place that a row does not name may hold any number.";
    this.body.replaceChildren(...page.rows.map((row) => this.row(page.places, row)));
    this.position.textContent = page.rows.length
      ? `${this.start + 1} to ${end} of ${page.total.toLocaleString("en")}`
      : "no rows";
    this.back.disabled = this.start === 0;
    this.on.disabled = end >= page.total;
  }

  row(places, { number: row, marking, choose, differs }) {
    const counts = markingOf(places, marking);
    return h(
      "tr",
      h(
        "td",
        h("button.link", {
          text: String(row),
          "aria-label": `Show row ${row} on the net`,
          onclick: () => this.paint(counts, choose, `Row ${row}`),
        }),
      ),
      h("td", markingText(counts)),
      h(
        "td",
        Object.keys(choose).length ? choiceText(choose) : "the robots wait",
        " ",
        differs === true && h("span.badge.warn", "differs"),
        differs === false && h("span.badge", "as before"),
      ),
    );
  }
}
