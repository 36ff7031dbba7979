// The source of a function that an action names, written in the page. The server checks it as one types, without
// running it, and puts it into the plan's folder.

import { h, attempt } from "../dom.js";
import { post } from "../api.js";
import { isReference } from "./data_form.js";
import { NAMES } from "./names.js";
import { typeOf } from "./schema.js";

const QUIET = 300; // ms without a key after which the source is checked
const LONGEST = 20_000; // characters; the server takes no more
const TYPES = { string: "str", number: "float", boolean: "bool", array: "list", object: "dict" };

/** A parameter as people read it: its name, and its type if that is known. */
export const parameterText = ({ name, type }) => (type ? `${name}: ${type}` : name);

/** The initial source of an action in a place. `settings`: the values that the plan gives to it. */
function stubOf(name, place, settings, leaving) {
  const typed = Object.entries(settings).map(([key, value]) =>
    parameterText({ name: key, type: isReference(value) ? "" : TYPES[typeOf(value)] }),
  );
  const plain = (text) => text.replace(/\\/g, "\\\\").replace(/"/g, "'");
  const ends = [...leaving.map(plain), "None: the policy decides"].join(", or ");
  return `def ${name}(${["robot", "is_cancelled", ...typed].join(", ")}):
    """What a robot does in ${plain(place)}.

    Returns the transition to fire: ${ends}.
    """
    is_cancelled.wait(1)  # instead of work: a second, or until the action is to end
    return None
`;
}

/** The server's answer about a function that the page may write: its source, or why not; undefined
until it has answered.
 * It is asked again when the palette has changed. */
function lookedUp(form, name, ask) {
  if (form.looked?.palette !== form.palette) form.looked = { palette: form.palette, at: new Map() };
  const { at } = form.looked;
  if (!at.has(name)) {
    at.set(name, undefined);
    const take = (found) => {
      at.set(name, found);
      form.refresh();
    };
    ask({ look: true }).then(take, () => {});
  }
  return at.get(name);
}

/** The button that opens the source of an action's function, if it is in the plan's folder or may be put there; once it
 * is open, the source. */
export function functionWriter(form, lens, action) {
  const name = typeof action === "string" ? action : action?.function;
  if (!form.palette || !/\.[A-Za-z]\w*$/.test(name ?? "")) return null;
  const ask = (fields) =>
    post("edit/function", { function: name, ...fields }, { id: form.mode.id });
  form.sources ??= new Map(); // what is open stays when something else is selected
  const typed = form.mode.files?.sources[name];
  if (typed && !form.sources.has(name)) form.sources.set(name, new Source(form, name, ask, typed));
  const open = form.sources.get(name);
  if (open) return open.element;
  const there = lookedUp(form, name, ask);
  if (!there || there.problem) return null;
  const key = `${lens.key} write`;
  const begin = () =>
    attempt(async () => {
      const found = await ask({});
      found.text ||= stubOf(
        name.split(".").pop(),
        lens.name,
        action?.settings ?? {},
        NAMES.leaving(form.state, lens.name),
      );
      form.sources.set(name, new Source(form, name, ask, found));
      form.wanted = `source ${name}`;
      form.refresh();
    });
  return h("div.buttons", form.button(key, there.text ? "Edit its source" : "Write it", begin));
}

class Source {
  constructor(form, name, ask, found) {
    Object.assign(this, { form, name, ask, file: found.file, version: found.version });
    this.area = h("textarea", {
      "data-key": `source ${name}`,
      "aria-label": `Source of ${name}`,
      rows: 14,
      spellcheck: "false",
      maxlength: LONGEST,
    });
    this.area.value = found.text;
    this.verdict = h("p.muted", { role: "status" });
    this.element = h(
      "div.source-text",
      h("p.muted", found.file),
      this.area,
      this.verdict,
      h(
        "div.buttons",
        form.button(`source ${name} save`, "Write to the file", () => attempt(() => this.save())),
        form.button(`source ${name} close`, "Close", () => this.close()),
      ),
    );
    this.area.addEventListener("input", () => {
      form.typing = true;
      this.keep();
      this.later();
    });
    this.area.addEventListener("keydown", (event) => this.indent(event));
    this.area.addEventListener("blur", () => {
      form.typing = false;
    });
    this.check();
  }

  /** A new line begins where the last one does, and further in after a colon. */
  indent(event) {
    if (event.key !== "Enter" || event.ctrlKey || event.metaKey || event.isComposing) return;
    const { selectionStart: at, selectionEnd: end, value } = this.area;
    const line = value.slice(value.lastIndexOf("\n", at - 1) + 1, at);
    const space = line.match(/^ */)[0] + (line.trimEnd().endsWith(":") ? "    " : "");
    event.preventDefault();
    this.area.setRangeText(`\n${space}`, at, end, "end");
    this.area.dispatchEvent(new Event("input"));
  }

  /** Keep what is typed with the draft. */
  keep() {
    const { file, version } = this;
    this.form.mode.files.keepSource(this.name, { file, version, text: this.area.value });
  }

  later() {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.check(), QUIET);
  }

  async check() {
    const text = this.area.value;
    const { problem, line, parameters } = await this.ask({ text }).catch(({ message }) => ({
      problem: message,
    }));
    if (text !== this.area.value) return;
    this.says(
      problem
        ? `${line ? `Line ${line}: ` : ""}${problem}`
        : parameters.length
          ? `Parameters: ${parameters.map(parameterText).join(", ")}`
          : "No parameters of its own",
      Boolean(problem),
    );
  }

  says(text, wrong) {
    this.verdict.className = wrong ? "wrong" : "muted";
    this.verdict.textContent = text;
    this.area.setAttribute("aria-invalid", wrong);
  }

  async save() {
    const sent = this.area.value;
    const { file, text, version } = await this.ask({
      text: sent,
      version: this.version,
      save: true,
    });
    this.version = version;
    if (this.area.value === sent) {
      this.area.value = text;
      this.form.mode.files.keepSource(this.name);
    } else this.keep();
    this.says(`Written to ${file}`, false);
    this.form.mode.dispatchEvent(new CustomEvent("functions"));
  }

  close() {
    clearTimeout(this.timer);
    this.form.sources.delete(this.name);
    this.form.mode.files.keepSource(this.name);
    this.form.refresh();
  }
}
