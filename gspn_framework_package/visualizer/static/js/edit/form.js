// Base of the editor's forms. A lens is a place in the document that a control reads and writes. Input is checked at
// once; an invalid value stays in the form with the reason next to it and never enters the document. Every edit, undo
// and redo redraws the form; the focus stays where it was.

import { h, isPressed, markWrong, refill, textField } from "../dom.js";
import { actOnChoice, completionsOf, selectOf } from "./menus.js";
import { onlyMoved } from "./plan_document.js";

let ids = 0;

/** An id that no other element has. */
const newId = () => `ed-field-${++ids}`;

/** A copy of an object or list with one entry replaced, or removed if `value` is undefined. */
function withEntry(whole, name, value) {
  if (Array.isArray(whole)) {
    const list = [...whole];
    if (value === undefined) list.splice(name, 1);
    else list[name] = value;
    return list;
  }
  const result = { ...whole };
  if (value === undefined) delete result[name];
  else result[name] = value;
  return result;
}

const isEmpty = (whole) => Object.keys(whole).length === 0;

/** The place of a value in the document. `key` names it ("plan.timeout.Fetch"); `pattern` is the key with * for names
 * given by users; `get()` reads it (undefined: absent), `put(value, label, merge)` makes the edit. */
export class Lens {
  constructor(key, get, put, pattern = key) {
    this.key = key;
    this.pattern = pattern;
    this.get = get;
    this.put = put;
  }

  /** An entry of the object or list here. `given`: the name was given by a user, or is an index. `drop`: remove the
   * object with its last entry. */
  at(name, { given = false, drop = false, list = false } = {}) {
    const lens = new Lens(
      `${this.key}.${name}`,
      () => this.get()?.[name],
      (value, label, merge) => {
        const whole = withEntry(this.get() ?? (list ? [] : {}), name, value);
        return this.put(drop && isEmpty(whole) ? undefined : whole, label, merge);
      },
      `${this.pattern}.${given ? "*" : name}`,
    );
    lens.name = name;
    return lens;
  }

  /** The same place with its value in another form. `part` extends the key: the part that is shown. */
  as(read, write, part = "") {
    const lens = new Lens(
      part ? `${this.key}.${part}` : this.key,
      () => read(this.get()),
      (value, label, merge) => this.put(write(value, this.get()), label, merge),
      this.pattern,
    );
    lens.name = this.name;
    return lens;
  }
}

/** The line below a field that says what is wrong with it, and what sets its text ("": nothing is). */
function reasonOf(input) {
  const wrong = h("p.wrong", { id: newId(), role: "alert", hidden: true });
  const says = (problem) => {
    wrong.textContent = problem;
    wrong.hidden = !problem;
    markWrong(input, problem && wrong);
  };
  return { wrong, says };
}

/** Stands for the values of several nodes that differ. */
export const MIXED = Symbol("several values");

/** A panel with a form. A subclass defines `content()`, which returns the elements, and may add further events that
 * redraw it. */
const SHARE = 4; // a form rests for this multiple of the time that drawing it took

export class FormPanel {
  constructor(mode, name, title) {
    this.mode = mode;
    this.element = h("div.ed-form", { id: `ed-${name}` });
    this.drafts = new Map(); // key -> {text or value, problem, base}: invalid input, which is not in the document
    this.open = new Map(); // key -> whether that section is unfolded
    this.session = 0; // counts visits to fields: the input of one visit is undone together
    this.typing = false;
    this.stale = true;
    this.timer = 0;
    this.next = 0; // the earliest time of the next drawing
    this.wanted = null; // key of the control that gets the focus at the next drawing
    this.element.addEventListener("focusin", () => this.session++);
    this.element.addEventListener("focusout", () => setTimeout(() => this.settle()));
    this.element.addEventListener("toggle", ({ target }) => this.fold(target), true);
    this.element.addEventListener("keydown", (event) => this.key(event));
    mode.onDocument(
      ({ detail }) => this.concerns(detail.before, this.state) && this.refresh(),
      "change",
    );
    new ResizeObserver(() => this.stale && this.settle()).observe(this.element);
    mode.panel(name, title, this.element);
  }

  /** Redraw whenever an event comes, until the mode is left. */
  listen(target, event) {
    target.addEventListener(event, () => this.refresh(), { signal: this.mode.bound.signal });
  }

  /** Undo and redo also work in a field, unless the user is typing in it: then they are the field's own. */
  key(event) {
    if (!(event.ctrlKey || event.metaKey) || event.altKey) return;
    const key = event.key.toLowerCase();
    if (key === "s" && this.typing) event.target.dispatchEvent(new Event("change")); // input in a field is saved too
    const redo = key === "y" || (key === "z" && event.shiftKey);
    if (this.typing || !(redo || key === "z")) return;
    event.preventDefault();
    event.stopPropagation();
    if (redo) this.mode.redo();
    else this.mode.undo();
  }

  /** Whether this panel may look different in two states. Moving nodes affects few panels. */
  concerns(before, after) {
    return !onlyMoved(before, after);
  }

  get document() {
    return this.mode.document;
  }

  get state() {
    return this.document.state;
  }

  fold(target) {
    if (target.dataset?.fold) this.open.set(target.dataset.fold, target.open);
  }

  /** Redraw now, or when the field is left if the user is typing. */
  refresh() {
    this.stale = true;
    this.settle();
  }

  settle() {
    if (!this.stale || this.typing || this.timer) return;
    const wait = this.next - performance.now();
    if (wait > 0 && !this.element.contains(document.activeElement)) {
      // of edits made elsewhere in quick succession, not all are shown
      this.timer = setTimeout(() => {
        this.timer = 0;
        this.settle();
      }, wait);
      return;
    }
    if (isPressed(this.element)) {
      setTimeout(() => this.settle(), 50);
      return;
    }
    if (this.element.closest("[hidden]")) return; // reading its size would lay out the whole page
    const begun = performance.now();
    this.draw();
    const now = performance.now();
    this.next = now + SHARE * (now - begun);
  }

  draw() {
    this.stale = false;
    for (const [key, draft] of this.drafts)
      if (draft.read() !== draft.base) this.drafts.delete(key); // another edit has changed it
    const active = this.element.contains(document.activeElement) ? document.activeElement : null;
    const key = this.wanted ?? active?.dataset.key;
    const range =
      typeof active?.selectionStart === "number"
        ? [active.selectionStart, active.selectionEnd]
        : null;
    this.wanted = null;
    // a section folded or unfolded just now, whose event has not arrived yet
    for (const details of this.element.querySelectorAll("details[data-fold]"))
      if (details.open !== details.drawnOpen) this.fold(details);
    refill(this.element, this.content());
    if (!key) return;
    const found = [...this.element.querySelectorAll("[data-key]")].find(
      (it) => it.dataset.key === key,
    );
    if (!found) {
      if (active) this.element.closest("[role='tabpanel']")?.focus();
      return;
    }
    found.focus();
    if (range && found === document.activeElement && found.dataset.key === active.dataset.key)
      try {
        found.setSelectionRange(...range);
      } catch {
        /* this kind of control has no text selection */
      }
  }

  // -- lenses ----------------------------------------------------------------------------------------

  /** A key of the plan. An optional key without entries is removed. */
  plan(key, drop = key !== "actions") {
    const plan = new Lens(
      "plan",
      () => this.document.plan,
      (value, label, merge) => this.document.edit(label, () => ({ plan: value }), merge),
    );
    const lens = plan.at(key);
    if (!drop) return lens;
    return lens.as(
      (value) => value,
      (value) => (value && typeof value === "object" && isEmpty(value) ? undefined : value),
    );
  }

  /** A value that enters the document only as a whole: while `check(value)` finds something wrong, it is kept in the
   * form. */
  whole(lens, check) {
    const whole = new Lens(
      lens.key,
      () => (this.drafts.has(lens.key) ? this.drafts.get(lens.key).value : lens.get()),
      (value, label, merge) => {
        const problem = value === undefined ? "" : check(value);
        if (problem) {
          const base = lens.get();
          this.drafts.set(lens.key, { value, problem, base, read: lens.get });
          this.showProblem(lens.key, problem);
          if (!this.typing) this.refresh();
          return false;
        }
        this.drafts.delete(lens.key);
        this.showProblem(lens.key, "");
        const done = lens.put(value, label, merge);
        if (!done && !this.typing) this.refresh();
        return done;
      },
      lens.pattern,
    );
    whole.name = lens.name;
    return whole;
  }

  /** The line that says why such a value is not in the document. */
  verdict(lens) {
    const problem = this.drafts.get(lens.key)?.problem ?? "";
    return h("p.wrong", {
      role: "status",
      "data-verdict": lens.key,
      text: problem && `Not in the plan yet: ${problem}`,
    });
  }

  showProblem(key, problem) {
    for (const line of this.element.querySelectorAll("[data-verdict]"))
      if (line.dataset.verdict === key)
        line.textContent = problem && `Not in the plan yet: ${problem}`;
  }

  // -- controls --------------------------------------------------------------------------------------

  /** A section that can be folded. If the body is a function, it is called when the section is unfolded. */
  section(key, title, open, ...body) {
    const unfolded = this.open.get(key) ?? open;
    const lazy = typeof body[0] === "function";
    const inside = h("div.body", lazy ? unfolded && body[0]() : body);
    const details = h(
      "details.question",
      { "data-fold": key, open: unfolded },
      h("summary", { text: title, "data-key": `fold ${key}` }),
      inside,
    );
    details.drawnOpen = unfolded;
    if (lazy && !unfolded)
      details.addEventListener(
        "toggle",
        () => inside.childElementCount || refill(inside, body[0]()),
      );
    return details;
  }

  /** A label and its control, as two cells of a form. */
  labelled(label, control, help = "") {
    const target = control.control ?? control;
    target.id ||= newId();
    if (help) target.title = help;
    return h(
      "div.field",
      h("label", { for: target.id, text: label, title: help }),
      h("div", control),
    );
  }

  /** Make the edit of a control. */
  put(lens, value, label, merge = null) {
    return lens.put(value, label, merge && `${merge}#${this.session}`);
  }

  /** A text field. `parse(text)` returns [value], or a text that says what is wrong; `show(value)` returns the text.
   * `late`: take the value when the field is left or Enter is pressed, not with every key. `names`: completions. */
  text(lens, label, options = {}) {
    const {
      parse = (it) => [it || undefined],
      show = (it) => it ?? "",
      late = false,
      ...rest
    } = options;
    const { names = null, what = label, ...attributes } = rest;
    const { key } = lens;
    const value = lens.get();
    const draft = this.drafts.get(`${key} text`);
    const input = textField({
      "data-key": key,
      ...attributes,
      placeholder: value === MIXED ? "several values" : attributes.placeholder,
      value: draft ? draft.text : value === MIXED ? "" : String(show(value)),
    });
    const list = names && completionsOf(input, newId(), names);
    const { wrong, says } = reasonOf(input);
    if (draft) says(draft.problem);
    const read = (enter) => {
      const found = parse(input.value);
      if (typeof found === "string") {
        this.drafts.set(`${key} text`, {
          text: input.value,
          problem: found,
          base: lens.get(),
          read: lens.get,
        });
        says(found);
        return;
      }
      this.drafts.delete(`${key} text`);
      says("");
      if (enter && found[0] !== lens.get()) this.put(lens, found[0], `Change ${what}`, key);
    };
    input.addEventListener("input", () => {
      this.typing = true;
      read(!late);
    });
    input.addEventListener("change", () => {
      this.typing = true; // the focus may be moving: its target must not be redrawn now
      read(true);
      this.typing = false;
      setTimeout(() => this.settle());
    });
    input.addEventListener("blur", () => {
      this.typing = false;
    });
    const cell = h("div.cell", input, list, wrong);
    cell.control = input;
    return cell;
  }

  /** A number. `blank`: the value of an empty field; if absent, the field must not be empty. */
  number(
    lens,
    label,
    { check = () => "", whole = false, formula = false, blank, ...options } = {},
  ) {
    return this.text(lens, label, {
      inputmode: formula ? "text" : whole ? "numeric" : "decimal",
      class: "number",
      ...options,
      parse: (text) => {
        if (!text.trim()) return blank === undefined ? "a number is needed" : [blank.value];
        const value = Number(text);
        if (formula && text.includes("#")) return check(text.trim()) || [text.trim()];
        if (!Number.isFinite(value)) return `'${text.trim()}' is not a number`;
        if (whole && !Number.isSafeInteger(value)) return "a whole number is needed";
        return check(value) || [value];
      },
      show: (value) => (value === undefined || value === null ? "" : value),
    });
  }

  /** A menu. `options`: [value, text]; values may be of any type. */
  choice(lens, label, options, { what = label, put = null, ...attributes } = {}) {
    const value = lens.get();
    const known = options.findIndex(([it]) => it === value);
    const all =
      known < 0
        ? [[value, value === MIXED ? "several values" : `${value ?? "choose …"}`], ...options]
        : options;
    const select = selectOf(
      { "data-key": lens.key, ...attributes },
      all.map(([it, text], i) => ({ value: i, text, selected: it === value })),
    );
    select.addEventListener("change", () => {
      const chosen = all[Number(select.value)][0];
      if (chosen === MIXED) return;
      if (put) put(chosen);
      else this.put(lens, chosen, `Change ${what}`);
    });
    return select;
  }

  check(lens, label, { what = label, absent = false } = {}) {
    const value = lens.get();
    const box = h("input", { type: "checkbox", "data-key": lens.key, checked: value === true });
    box.indeterminate = value === MIXED;
    box.addEventListener("change", () =>
      this.put(lens, box.checked === absent ? undefined : box.checked, `Change ${what}`),
    );
    return box;
  }

  button(key, face, act, attributes = {}) {
    return h("button", { type: "button", "data-key": key, onclick: act, ...attributes }, face);
  }

  /** The button that removes an entry; the focus then goes to `next` (a key). */
  remove(key, what, act, next) {
    return this.button(
      `${key} remove`,
      "×",
      () => {
        this.wanted = next ?? null;
        act();
      },
      { class: "icon", "aria-label": `Remove ${what}`, title: `Remove ${what}` },
    );
  }

  /** The button that removes the value of a lens. */
  removal(lens, what, next, label = `Remove ${what}`) {
    return this.remove(lens.key, what, () => this.put(lens, undefined, label), next);
  }

  /** A menu that adds the entry chosen. */
  adder(key, label, names, add) {
    const select = selectOf({ "data-key": `${key} add`, "aria-label": label }, [
      { value: "", text: `${label} …` },
      ...names.map((name) => ({ value: name, text: name })),
    ]);
    actOnChoice(select, add);
    select.disabled = !names.length;
    return select;
  }

  /** A field and a button that add a named entry. `check(name)` says what is wrong with the name. */
  namer(key, label, check, add, names = null) {
    const input = textField({
      "aria-label": label,
      placeholder: label,
      "data-key": `${key} add`,
    });
    const { wrong, says } = reasonOf(input);
    const act = () => {
      const problem = check(input.value);
      says(problem);
      if (problem) input.focus();
      else add(input.value);
    };
    input.addEventListener("keydown", (event) => {
      if (event.key !== "Enter") return;
      event.preventDefault();
      act();
    });
    return h(
      "div.adder",
      h(
        "div.entry",
        input,
        names && completionsOf(input, newId(), names),
        this.button(`${key} add it`, "Add", act, { "aria-label": `Add: ${label}` }),
      ),
      wrong,
    );
  }
}
