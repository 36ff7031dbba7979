// The policy as a table: a column for each place in the rows, a row for each marking, and the transitions
// that it chooses.

import { columns, h, plural, table } from "../dom.js";
import { Lens } from "./form.js";
import { iconOf } from "./icons.js";
import { mendButton } from "./mend.js";
import { NAMES } from "./names.js";
import { PlanForm } from "./property_panel.js";
import { ProposedRows } from "./proposed_rows.js";
import { problemOfSum, scaled } from "./schema.js";

const ROWS = 20; // on one page of the table

/** Why the choice of a row is not valid; "" if it is. */
function problemOfChoice(choose) {
  const values = Object.values(choose).map(Number);
  if (!values.length) return ""; // the robots wait
  if (values.some((value) => !(value >= 0))) return "a probability is at least 0";
  return problemOfSum(choose);
}

const wild = (cell) => cell === "-";

/** A cell as the file has it: a number, a comparison such as ">= 1", or "-"; null if the text is none of them. */
function cellOf(text) {
  const said = String(text).trim();
  if (said === "-" || said === "") return "-";
  if (/^\d{1,9}$/.test(said)) return Number(said);
  const [, sign, tokens] = /^(<=?|>=?|!=)\s*(\d{1,9})$/.exec(said) ?? [];
  return sign === undefined || (sign === "<" && !Number(tokens))
    ? null
    : `${sign} ${Number(tokens)}`;
}

/** The counts that fit a cell, as ranges [least, most]. */
function ranges(cell) {
  if (wild(cell)) return [[0, Infinity]];
  const [, sign, text] = /^([<>!]?=?)\s*(\d+)$/.exec(String(cell).trim()) ?? [];
  const n = Number(text);
  if (text === undefined) return [];
  if (!sign) return [[n, n]];
  const below = [0, sign === "<=" ? n : n - 1];
  const above = [sign === ">=" ? n : n + 1, Infinity];
  return { "!": [below, above], "<": [below], ">": [above] }[sign[0]];
}

/** Whether some marking fits both rows. */
const meet = (one, other) =>
  one.marking.every((cell, i) =>
    ranges(cell).some(([least, most]) =>
      ranges(other.marking[i]).some(([low, high]) => Math.max(least, low) <= Math.min(most, high)),
    ),
  );

/** The sort key of rows: wildcards, comparisons. */
const looseness = ({ marking }) => [
  marking.filter(wild).length,
  marking.filter((cell) => /[<>!]/.test(cell)).length,
];

/** The rows that can match in one marking with row `i` and decide for robots of the same place: those that come
 * before it, and those that come after it, as numbers from 0. `sources`: transition -> the places it leaves. */
function together(rows, i, sources) {
  const places = (row) =>
    Object.entries(row.choose)
      .filter(([, share]) => Number(share) > 0)
      .flatMap(([name]) => sources.get(name) ?? []);
  const row = rows[i];
  const [mine, rank] = [new Set(places(row)), looseness(row)];
  const waits = !Object.keys(row.choose).length;
  const [before, after] = [[], []];
  rows.forEach((other, at) => {
    if (at === i || !meet(row, other)) return;
    const silent = !Object.keys(other.choose).length;
    if (waits ? silent : !silent && !places(other).some((place) => mine.has(place))) return;
    const [wilds, tests] = looseness(other);
    (wilds - rank[0] || tests - rank[1] || at - i) < 0 ? before.push(at) : after.push(at);
  });
  return { before, after };
}

/** Such rows in words. */
function togetherText({ before, after }) {
  const listed = (rows) => {
    const numbers = rows.slice(0, 6).map((at) => at + 1);
    return `${numbers.join(", ")}${rows.length > 6 ? ", …" : ""}`;
  };
  const first =
    before.length > 1 ? `rows ${listed(before)} go first` : `row ${listed(before)} goes first`;
  return [
    ...(before.length ? [first] : []),
    ...(after.length ? [`goes before ${after.length > 1 ? "rows" : "row"} ${listed(after)}`] : []),
  ].join("; ");
}

/** Which rows never apply, because an earlier row has the same marking and names the same transitions, and which apply
 * only where others do not: row number (from 0) -> text to show. */
export function overlaps(rows) {
  const seen = new Map();
  const found = new Map();
  rows.forEach((row, i) => {
    const marking = row.marking.map((cell) => cellOf(cell) ?? cell).join(" ");
    const before = seen.get(marking) ?? [];
    const covered = before.find((at) => {
      const other = rows[at].choose;
      const names = Object.keys(row.choose).filter((name) => Number(row.choose[name]) > 0);
      return (
        !Object.keys(other).length ||
        (names.length && names.every((name) => Number(other[name]) > 0))
      );
    });
    if (covered !== undefined)
      found.set(
        i,
        `row ${covered + 1} has the same marking and comes first: this row never applies`,
      );
    seen.set(marking, [...before, i]);
  });
  return found;
}

export class PolicyPanel extends PlanForm {
  constructor(mode) {
    super(mode, "policy", "Policy");
    this.first = 0; // the first row on the page of the table
    this.proposed = new ProposedRows(this);
    this.listen(mode, "findings");
  }

  get policy() {
    return this.document.policy ?? { places: [], rows: [] };
  }

  /** A lens at the policy; a policy without places and rows is removed. */
  lens() {
    return new Lens(
      "policy",
      () => this.policy,
      (value, label, merge) =>
        this.document.edit(
          label,
          () => ({
            policy: value.places.length || value.rows.length || value.description ? value : null,
          }),
          merge,
        ),
    );
  }

  row(i) {
    return this.lens().at("rows").at(i, { given: true });
  }

  content() {
    const { policy } = this;
    this.immediate = NAMES.immediate(this.state);
    const last = Math.max(0, Math.floor((policy.rows.length - 1) / ROWS) * ROWS);
    this.first = Math.min(this.first, last);
    return [
      policy.scopes &&
        h(
          "p.muted",
          "This policy contains parts generated from subnets: edit the plan that contains the subnets instead.",
        ),
      h(
        "p.muted",
        policy.rows.length
          ? "Of the rows that match, the one with the fewest “-” (any number) decides, then the one with the " +
              "fewest comparisons (“>= 1”), then the first. Weights decide where no row matches."
          : "There are no rows, so the weights of the transitions decide.",
      ),
      this.gaps(),
      this.columns(policy),
      policy.rows.length > 0 && this.table(policy),
      h(
        "div.buttons",
        this.button("policy.rows add", "Add a row", () => this.addRow(), {
          disabled: !this.immediate.length,
          title: this.immediate.length ? "" : "The net has no immediate transition to choose",
        }),
        this.button("policy here", "What would happen here?", () => this.mode.showPanel("here"), {
          title: "Which row applies in a marking, and what robots would choose",
        }),
      ),
      this.general(),
      this.section("policy proposed", "Rows that the optimiser proposes", false, () =>
        this.proposed.content(),
      ),
    ];
  }

  /** Findings of the check about the policy as a whole, such as markings that no row covers, or that there are none. */
  gaps() {
    const found = this.mode.findings.filter(
      ({ text, elements }) =>
        /\b(policy|row|rows)\b/.test(text) && !elements.some(({ kind }) => kind === "row"),
    );
    return (
      found.length > 0 &&
      h(
        "ul.ed-gaps",
        { "aria-label": "Results of the check of the policy" },
        found
          .slice(0, 10)
          .map(({ level, text, hint, mend }) =>
            level === "note"
              ? h("li.muted", `✓ ${text}`)
              : h("li.mark", `⚠ ${text}${hint ? ` (${hint})` : ""}`, mendButton(this.mode, mend)),
          ),
      )
    );
  }

  // -- columns ---------------------------------------------------------------------------------------

  columns(policy) {
    const lens = this.lens();
    const offered = NAMES.places(this.state).filter((name) => !policy.places.includes(name));
    return h(
      "fieldset",
      h("legend", "Places in the rows"),
      h(
        "ul.chips",
        policy.places.map((name, i) =>
          h(
            "li",
            h("span", name),
            i > 0 &&
              this.button(`policy.places.${name} left`, "←", () => this.moveColumn(i, i - 1), {
                class: "icon",
                "aria-label": `Move the column ${name} to the left`,
              }),
            this.remove(
              `policy.places.${name}`,
              `the column ${name}`,
              () =>
                this.put(
                  lens,
                  withoutColumn(this.policy, i),
                  `Remove the column ${name} of the policy`,
                ),
              "policy.places add",
            ),
          ),
        ),
      ),
      this.adder("policy.places", "Add a column", offered, (name) => {
        this.wanted = "policy.places add";
        const { policy: now } = this;
        this.put(
          lens,
          {
            ...now,
            places: [...now.places, name],
            rows: now.rows.map((row) => ({ ...row, marking: [...row.marking, "-"] })),
          },
          `Add the column ${name} to the policy`,
        );
      }),
    );
  }

  moveColumn(from, to) {
    const { policy } = this;
    this.wanted = `policy.places.${policy.places[from]} left`;
    this.put(
      this.lens(),
      {
        ...policy,
        places: moved(policy.places, from, to),
        rows: policy.rows.map((row) => ({ ...row, marking: moved(row.marking, from, to) })),
      },
      `Move the column ${policy.places[from]} of the policy`,
    );
  }

  // -- rows ------------------------------------------------------------------------------------------

  table(policy) {
    const marks = this.marks(policy);
    const page = policy.rows.slice(this.first, this.first + ROWS);
    const turn = (key, text, to, disabled) =>
      this.button(
        `policy ${key}`,
        text,
        () => {
          this.first = to;
          this.refresh();
        },
        { disabled },
      );
    return [
      h(
        "div.scroll",
        { tabindex: "0", role: "region", "aria-label": "Rows of the policy" },
        table(
          "table.ed-policy",
          columns(["Row", ...policy.places, "Chooses"]),
          page.map((row, i) =>
            this.tableRow(policy, row, this.first + i, marks.get(this.first + i)),
          ),
        ),
      ),
      policy.rows.length > ROWS &&
        h(
          "div.buttons",
          turn("earlier", "Earlier rows", this.first - ROWS, this.first === 0),
          turn("later", "More rows", this.first + ROWS, this.first + ROWS >= policy.rows.length),
          h("span.muted", {
            role: "status",
            text: `${this.first + 1} to ${this.first + page.length} of ${plural(policy.rows.length, "row")}`,
          }),
        ),
    ];
  }

  /** Remarks on rows: row (from 0) -> [texts], from the check and from the table itself. */
  marks(policy) {
    const found = new Map();
    const add = (i, text) => found.set(i, [...(found.get(i) ?? []), text]);
    if (policy !== this.judged) {
      this.judged = policy;
      this.overlaps = overlaps(policy.rows);
    }
    for (const [i, text] of this.overlaps) add(i, text);
    for (const { text, elements } of this.mode.findings)
      for (const { kind, name } of elements) if (kind === "row") add(Number(name) - 1, text);
    return found;
  }

  tableRow(policy, row, i, marks = []) {
    const lens = this.row(i);
    const named = (what, act, face, disabled = false) =>
      this.button(`policy.rows.${i} ${what}`, face, act, {
        class: "icon",
        "aria-label": `${what} row ${i + 1}`,
        title: `${what} row ${i + 1}`,
        disabled,
      });
    return h(
      "tr",
      { class: marks.length ? "marked" : "" },
      h("th", { scope: "row" }, String(i + 1)),
      policy.places.map((place, at) => h("td", this.cell(lens.at("marking").at(at), place, i))),
      h(
        "td",
        this.choose(lens, row, i),
        marks.map((text) => h("p.mark", `⚠ ${text}`)),
        h("p.muted.meets", {
          title: "Rows that can match in the same marking",
          text: this.meeting(i),
        }),
        h(
          "div.row-buttons",
          named("Move up", () => this.moveRow(i, i - 1), "↑", i === 0),
          named("Move down", () => this.moveRow(i, i + 1), "↓", i === policy.rows.length - 1),
          named(
            "Duplicate",
            () => this.insertRow(i + 1, row, `Duplicate row ${i + 1} of the policy`),
            iconOf("row-duplicate"),
          ),
          this.remove(
            `policy.rows.${i}`,
            `row ${i + 1}`,
            () => this.removeRow(i),
            "policy.rows add",
          ),
        ),
      ),
    );
  }

  cell(lens, place, i) {
    return this.text(lens, `${place} in row ${i + 1}`, {
      "aria-label": `${place} in row ${i + 1}`,
      class: "cell-input",
      title: "A number of tokens; >= 1, > 1, <= 1, < 1 or != 1; - for any",
      what: `row ${i + 1} of the policy`,
      show: (value) => String(value),
      parse: (text) => {
        const cell = cellOf(text);
        return cell === null
          ? "a number of tokens, a comparison such as >= 1, or - for any"
          : [cell];
      },
    });
  }

  /** Which rows can match where row `i` does, in words. */
  meeting(i) {
    const { rows } = this.policy;
    const { net, plan } = this.state;
    if (this.met?.rows !== rows || this.met.net !== net || this.met.plan !== plan)
      this.met = { rows, net, plan, sources: this.sources(), texts: new Map() };
    const { sources, texts } = this.met;
    if (!texts.has(i)) texts.set(i, togetherText(together(rows, i, sources)));
    return texts.get(i);
  }

  /** Transition -> the places that it takes robots from. */
  sources() {
    const { net, plan } = this.state;
    const resources = new Set(plan.resource_places);
    const found = new Map();
    for (const { from, to, inhibitor } of net.arcs)
      if (!inhibitor && !resources.has(from)) found.set(to, [...(found.get(to) ?? []), from]);
    return found;
  }

  /** The transitions of a row and their probabilities. Probabilities that do not add up to 1 stay in the form. */
  choose(row, value, i) {
    const whole = this.whole(row.at("choose"), problemOfChoice);
    const now = whole.get() ?? {};
    const names = Object.keys(now);
    const what = `row ${i + 1} of the policy`;
    const renamed = (name, to) => {
      const entries = Object.entries(whole.get()).map(([key, share]) => [
        key === name ? to : key,
        share,
      ]);
      this.wanted = `${whole.key}.${to} name`;
      this.put(whole, Object.fromEntries(entries), `Change ${what}`);
    };
    const offered = this.immediate.filter((name) => !(name in now));
    return h(
      "div.chosen",
      names.length === 0 && h("span.muted", "the robots wait"),
      names.map((name) =>
        h(
          "div.entry",
          this.choice(
            new Lens(
              `${whole.key}.${name} name`,
              () => name,
              () => false,
            ),
            name,
            [name, ...offered].map((it) => [it, it]),
            {
              "aria-label": `Transition of row ${i + 1}`,
              put: (to) => to !== name && renamed(name, to),
            },
          ),
          this.number(whole.at(name), `probability of ${name} in row ${i + 1}`, {
            "aria-label": `Probability of ${name} in row ${i + 1}`,
            what,
            check: (share) => (share < 0 || share > 1 ? "between 0 and 1" : ""),
          }),
          this.remove(
            `${whole.key}.${name}`,
            `${name} from row ${i + 1}`,
            () => {
              const { [name]: gone, ...rest } = whole.get();
              this.put(
                whole,
                gone === 1 || Number(gone) === 0 ? rest : scaled(rest),
                `Change ${what}`,
              );
            },
            `${whole.key} add`,
          ),
        ),
      ),
      this.verdict(whole),
      h(
        "div.entry",
        this.adder(whole.key, `Add to row ${i + 1}`, offered, (name) => {
          this.wanted = `${whole.key}.${name}`;
          const before = whole.get() ?? {};
          const full = Object.keys(before).length > 0;
          this.put(whole, { ...before, [name]: full ? 0 : 1 }, `Change ${what}`);
        }),
        names.length > 1 &&
          this.button(
            `${whole.key} fit`,
            "Scale to 1",
            () => this.put(whole, scaled(whole.get()), `Change ${what}`),
            {
              "aria-label": `Scale to 1: the probabilities of row ${i + 1}`,
            },
          ),
      ),
    );
  }

  addRow() {
    const { policy } = this;
    const first = [...this.mode.selection].find((key) => key.startsWith("transition:"));
    const chosen = first?.slice("transition:".length);
    const transition = this.immediate.includes(chosen) ? chosen : this.immediate[0];
    this.insertRow(
      policy.rows.length,
      { marking: policy.places.map(() => "-"), choose: { [transition]: 1 } },
      "Add a row to the policy",
    );
  }

  insertRow(at, row, label) {
    const { policy } = this;
    const rows = [...policy.rows];
    rows.splice(at, 0, { ...row });
    if (at >= this.first + ROWS) this.first = Math.floor(at / ROWS) * ROWS;
    this.wanted = policy.places.length
      ? `policy.rows.${at}.marking.0`
      : `policy.rows.${at} Duplicate`;
    this.putRows(rows, label);
  }

  putRows(rows, label) {
    this.drafts.clear(); // they are stored by row number
    this.put(this.lens(), { ...this.policy, rows }, label);
  }

  removeRow(i) {
    const left = this.policy.rows.filter((_, at) => at !== i);
    this.putRows(left, `Remove row ${i + 1} of the policy`);
  }

  moveRow(from, to) {
    this.wanted = `policy.rows.${to} ${to < from ? "Move up" : "Move down"}`;
    this.putRows(moved(this.policy.rows, from, to), `Move row ${from + 1} of the policy`);
  }

  /** The description of the policy, and whether a marking without a matching row is a fault. */
  general() {
    const { policy } = this;
    if (!policy.rows.length) return null;
    const strict = this.plan("strict");
    return [
      this.labelled(
        "Description",
        this.text(this.lens().at("description"), "the description of the policy"),
      ),
      this.labelled(
        "A marking without a row is a fault (strict)",
        this.check(strict, "strict", { absent: false }),
        this.part("strict").description,
      ),
    ];
  }
}

/** A list with one of its items in another position. */
function moved(list, from, to) {
  const result = [...list];
  result.splice(to, 0, ...result.splice(from, 1));
  return result;
}

/** A policy without a column. */
function withoutColumn(policy, i) {
  return {
    ...policy,
    places: policy.places.filter((_, at) => at !== i),
    rows: policy.rows.map((row) => ({ ...row, marking: row.marking.filter((_, at) => at !== i) })),
  };
}
