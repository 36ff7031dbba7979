// The plan being edited, and the history of its edits. The state is one immutable value {plan, net, policy}; an edit
// replaces it by another that shares all unchanged parts. Undo and redo go back and forth between the states, so every
// edit is undone exactly. Somebody else's changes are not edits: they stay when one's own edit is undone.

import { merged } from "./merge.js";

const KEPT = 5000; // edits that can be undone

const withoutPosition = (node) => Object.keys(node).filter((key) => key !== "position");

const sameButMoved = (one, other) =>
  one === other ||
  (withoutPosition(one).join() === withoutPosition(other).join() &&
    withoutPosition(one).every((key) => one[key] === other[key]));

const moved = { before: null, after: null, only: false }; // cache of the last question: several parts ask the same one

/** Whether two states differ only in the positions of nodes. */
export function onlyMoved(before, after) {
  if (moved.before === before && moved.after === after) return moved.only;
  const [a, b] = [before.net, after.net];
  const only =
    before.plan === after.plan &&
    before.policy === after.policy &&
    a.arcs === b.arcs &&
    a.name === b.name &&
    ["places", "transitions"].every(
      (list) =>
        a[list].length === b[list].length && a[list].every((it, i) => sameButMoved(it, b[list][i])),
    );
  Object.assign(moved, { before, after, only });
  return only;
}

/** Fires "change" (detail {before, edit}) after each edit, undo and redo; "saved" when the present state is on the
 * disk. */
export class PlanDocument extends EventTarget {
  /** `state`: {plan, net, policy}: the JSON objects of the plan file, its net, and its policy or null. */
  constructor(state) {
    super();
    this.state = state;
    this.saved = state; // the state in the files
    this.done = []; // edits, the latest last: {label, before, after, merge}
    this.undone = [];
  }

  get net() {
    return this.state.net;
  }

  get plan() {
    return this.state.plan;
  }

  get policy() {
    return this.state.policy;
  }

  /** Whether there is something to save. */
  get dirty() {
    return this.state !== this.saved;
  }

  /** Make an edit. `label` says what it does ("Add place P1"); `change` takes the state and returns its changed parts,
   * e.g. {net}. Consecutive edits with the same `merge` (a drag, typing in one field) are undone together. Returns
   * whether anything changed. */
  edit(label, change, merge = null) {
    const before = this.state;
    const after = { ...before, ...change(before) };
    if (Object.keys(after).every((key) => after[key] === before[key])) return false;
    const last = this.done[this.done.length - 1];
    const edit = { label, before, after, merge };
    if (merge !== null && last?.merge === merge && last.after === before && before !== this.saved)
      edit.before = this.done.pop().before;
    this.done.push(edit);
    if (this.done.length > KEPT) this.done.shift();
    this.undone = [];
    this.put(after, edit);
    return true;
  }

  undo() {
    const edit = this.done.pop();
    if (!edit) return null;
    this.undone.push(edit);
    this.put(this.moved(edit.after, edit.before), edit);
    return edit;
  }

  redo() {
    const edit = this.undone.pop();
    if (!edit) return null;
    this.done.push(edit);
    this.put(this.moved(edit.before, edit.after), edit);
    return edit;
  }

  /** The present state with the change from one state to another, which is that other one if nobody else has made
   * changes meanwhile. What somebody else changed too stays as it is. */
  moved(from, to) {
    const { state } = this;
    return state === from ? to : merged(from, state, to, { rename: false }).state;
  }

  /** Continue with a state and the history that led to it: {done, undone}. */
  restore(state, history) {
    Object.assign(this, history);
    this.put(state, null);
  }

  /** Use a state in which somebody else's changes are merged. */
  follow(state) {
    if (state !== this.state) this.put(state, null);
  }

  /** Record that the files contain `state` (the one that was sent). */
  markSaved(state = this.state) {
    this.saved = state;
    this.dispatchEvent(new CustomEvent("saved"));
  }

  /** Go back to the state in the files; this can be undone. */
  giveUp() {
    if (!this.dirty) return;
    this.edit("Leave without saving", () => this.saved);
    this.markSaved();
  }

  put(state, edit) {
    const before = this.state;
    this.state = state;
    this.dispatchEvent(new CustomEvent("change", { detail: { before, edit } }));
  }
}
