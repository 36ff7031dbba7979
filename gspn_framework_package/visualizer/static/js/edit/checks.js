// The check while editing: marks at the nodes, the list of findings, and "What would happen here?". A state is called
// checked only if the server has checked exactly this state.

import { h, plural } from "../dom.js";
import { post } from "../api.js";
import { mendButton } from "./mend.js";
import { onlyMoved } from "./plan_document.js";

const QUIET = 1000; // ms without an edit after which the state is checked: findings appear when editing pauses
const LISTED = 60; // findings listed per level
const LEVELS = { error: "Error", warning: "Warning", note: "Note" };
const RANK = { error: 3, warning: 2, note: 1 };

/** The keys of the elements that a finding is about. */
const keysOf = (elements) =>
  elements
    .filter(({ kind }) => ["place", "transition", "arc"].includes(kind))
    .map(({ kind, name }) => `${kind}:${name}`);

/** Sets `mode.findings` and fires "findings" on the mode. */
export class Checks {
  constructor(mode) {
    this.mode = mode;
    mode.findings = [];
    this.revision = 0;
    this.timer = 0;
    this.asked = null; // the state being checked, or checked last; positions do not matter to the check
    this.state = h("p.ed-check-state", { id: "ed-check-state", role: "status" });
    this.again = h("button", { text: "Check again", hidden: true, onclick: () => this.check() });
    this.list = h("div.ed-findings", { id: "ed-findings" });
    this.agents = h("input", { type: "checkbox", id: "ed-agents", onchange: () => this.check() });
    mode.panel(
      "checks",
      "Check",
      h(
        "div",
        h("div.buttons", this.state, this.again),
        h(
          "label.check",
          {
            title: "Transitions may create and destroy agents, but not robots.",
          },
          this.agents,
          " for agents without ROS (gspn run), not for robots",
        ),
        this.list,
      ),
    );
    this.chip = mode.button("look", {
      id: "ed-verdict",
      label: "Check",
      title: "Results of the check",
      onclick: () => mode.showPanel("checks"),
    });
    mode.onDocument(() => this.later(), "change");
    mode.addEventListener("functions", () => this.check());
    this.check();
  }

  showState(state, text) {
    this.state.dataset.state = state;
    this.state.textContent = text;
    this.chip.dataset.state = state;
    const [verdict] = text.split(/[.:…]/);
    this.chip.lastChild.textContent = state === "checking" ? "Checking …" : verdict;
    this.list.classList.toggle("stale", state === "checking" || state === "unknown");
    this.again.hidden = state !== "unknown";
  }

  later() {
    if (this.asked && onlyMoved(this.asked, this.mode.document.state)) return;
    this.revision += 1; // answers that arrive now are about another state
    this.mode.unjudged = true;
    for (const button of this.list.querySelectorAll(".mend")) button.disabled = true;
    this.showState("checking", "Checking … the findings below are those before the last edit.");
    this.wait();
  }

  /** Check once nothing has been edited for a while, and no gesture or name is unfinished. */
  wait() {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => {
      const { pointer, renaming } = this.mode;
      if (pointer.gesture || renaming) this.wait();
      else this.check();
    }, QUIET);
  }

  /** Check the present state quickly; if a question stays open, check again with the limits of gspn check. */
  async check() {
    clearTimeout(this.timer);
    const { state } = this.mode.document;
    this.asked = state;
    this.revision += 1;
    const { revision } = this;
    this.showState("checking", "Checking …");
    try {
      const first = await this.ask(state, revision, false);
      if (!first) return;
      this.show(first);
      if (first.decided) return;
      this.showState(
        "checking",
        `${this.verdict(first)} so far, after ${plural(first.states, "marking")}. Checking further …`,
      );
      const whole = await this.ask(state, revision, true);
      if (whole) this.show(whole);
    } catch (error) {
      if (revision !== this.revision || this.closed) return;
      this.asked = null;
      this.showState("unknown", `Not checked: ${error.message}.`);
    }
  }

  /** The server's answer; null if the state has changed since. */
  async ask(state, revision, full) {
    const answer = await post(
      "edit/check",
      { document: state, revision, full, page: this.mode.visit, standalone: this.agents.checked },
      { id: this.mode.id },
    );
    if (revision !== this.revision || this.closed) return null;
    if (answer.cancelled) throw new Error("another check took its place");
    return answer;
  }

  verdict({ valid, doubts, findings }) {
    const count = (level) => findings.filter((finding) => finding.level === level).length;
    const warnings = count("warning");
    const more = warnings ? `, ${plural(warnings, "warning")}` : "";
    const errors = count("error"); // an empty net, or one without robots, cannot be judged yet
    if (!this.mode.document.net.places.length) return "Nothing drawn";
    if (!valid)
      return errors ? `Not valid: ${plural(errors, "error")}${more}` : `Not finished${more}`;
    return doubts.length ? `May run, but ${doubts.join(", and ")}${more}` : `May run${more}`;
  }

  show(answer) {
    const { valid, doubts, decided, findings } = answer;
    this.mode.findings = findings;
    this.mode.unjudged = false;
    const drawn = this.mode.document.net.places.length > 0;
    const wrong = !valid && findings.some(({ level }) => level === "error");
    this.showState(
      wrong
        ? "invalid"
        : !valid || !decided || !drawn
          ? "undecided"
          : doubts.length
            ? "doubtful"
            : "checked",
      `${this.verdict(answer)}.${decided ? "" : " Not all questions could be decided."}`,
    );
    this.mark(findings);
    this.list.replaceChildren(
      ...Object.keys(LEVELS).map((level) =>
        this.section(
          level,
          findings.filter((finding) => finding.level === level),
        ),
      ),
    );
    this.mode.dispatchEvent(new CustomEvent("findings", { detail: findings }));
  }

  mark(findings) {
    const marks = new Map();
    for (const { level, text, elements } of findings) {
      if (level === "note") continue;
      const keys = elements.flatMap(({ kind, name }) =>
        kind === "arc"
          ? name.split(">").flatMap((end) => [`place:${end}`, `transition:${end}`])
          : [`${kind}:${name}`],
      );
      for (const key of keys) {
        const mark = marks.get(key);
        if (!mark) marks.set(key, { level, text });
        else if (mark.text !== text)
          marks.set(key, {
            level: RANK[level] > RANK[mark.level] ? level : mark.level,
            text: `${mark.text}\n${text}`,
          });
      }
    }
    this.mode.canvas.mark(marks);
  }

  section(level, findings) {
    if (!findings.length) return "";
    const items = findings.slice(0, LISTED).map((finding) => this.item(finding));
    if (findings.length > LISTED) items.push(h("li.muted", `and ${findings.length - LISTED} more`));
    const list = h("ul", { class: `ed-level ${level}` }, items);
    return level === "note"
      ? h("details", h("summary", plural(findings.length, "note")), list)
      : list;
  }

  item({ level, text, hint, elements, witness, markings, mend }) {
    const keys = keysOf(elements);
    const rows = elements.filter(({ kind }) => kind === "row");
    const said = [h("strong", `${LEVELS[level]}: `), text];
    return h(
      "li",
      keys.length || rows.length
        ? h("button.link", { onclick: () => this.go(keys, rows) }, said)
        : h("span", said),
      hint && h("div.muted", hint),
      witness?.length
        ? h("button", {
            text: `Play ${plural(witness.length, "step")}`,
            title: `Firings that lead to it: ${witness.slice(0, 20).join(", ")}${witness.length > 20 ? ", …" : ""}`,
            onclick: () => this.mode.play(witness, markings),
          })
        : "",
      mendButton(this.mode, mend),
    );
  }

  /** Select the elements that a finding is about, and move the view there. */
  go(keys, rows) {
    if (keys.length) {
      this.mode.choose(keys);
      const shown = keys.find((key) => this.mode.selection.has(key));
      if (shown) this.mode.canvas.flyTo(shown);
    } else if (rows.length) this.mode.showPanel("policy");
  }

  close() {
    this.closed = true;
    clearTimeout(this.timer);
  }
}
