// Between the page and the mode EDIT: opens and leaves it, and keeps the documents that stay open.

import { $, h, announce, ask, attempt } from "../dom.js";
import { get } from "../api.js";
import { hideOpening } from "../opening.js";
import { mayEdit } from "./new_plan.js";

const FILE = "file-";

/** Whether there is work that is not in files: edits, or sources of functions. */
export const hasUnsaved = ({ document, opened }) =>
  document.dirty || Object.keys(opened.sources ?? {}).length > 0;

/** Ask whether to discard unsaved work; `save` saves it, or is null. Returns whether to continue. */
async function mayLeave(names, save) {
  const answer = await ask("Leave without saving?", h("p", `Not saved: ${names.join(", ")}.`), [
    ["Stay", ""],
    ["Leave without saving", "leave", "danger"],
    ...(save ? [["Save and leave", "save", "primary"]] : []),
  ]);
  if (answer === "save") return save();
  announce(answer === "leave" ? "Left without saving" : "");
  return answer === "leave";
}

export class Editor {
  constructor(page) {
    this.page = page;
    this.mode = null;
    this.kept = new Map(); // key -> {opened, document}: what was opened since the editor was entered
    this.left = new Map(); // the same for earlier visits: an edit can be undone later while the files are unchanged
    this.trail = []; // keys of the files on the path to the open one
    $("ed-open").onclick = () => page.edit(page.model.session.id);
    $("ed-close").onclick = () => page.go(this.id);
    addEventListener("beforeunload", (event) => {
      if (this.unsaved.length) event.preventDefault();
    });
  }

  /** The key of the file that is being edited, or null. */
  get id() {
    return this.mode?.id ?? null;
  }

  /** The keys of the documents with unsaved work. */
  get unsaved() {
    return [...this.kept].filter(([, kept]) => hasUnsaved(kept)).map(([key]) => key);
  }

  showButtons() {
    const key = this.page.model?.session.id;
    $("ed-open").hidden = !(key?.startsWith(FILE) && mayEdit(this.page.hello));
    $("ed-close").hidden = !this.mode;
  }

  /** Edit a file. Changes to other files since the editor was entered are kept. */
  async open(key) {
    hideOpening();
    const { page } = this;
    const kept = this.kept.get(key);
    // half of the page's modules belong to the mode, and a viewer who only watches does not need them
    const [{ EditMode }, opened] = (await attempt(() =>
      Promise.all([import("./mode.js"), kept?.opened ?? get("edit", { id: key })]),
    )) ?? [{}];
    if (!opened) {
      if (this.mode) history.replaceState(null, "", `#${encodeURIComponent(this.id)}&edit`);
      else page.go(key);
      return;
    }
    const left = kept ? null : this.left.get(key);
    const edited = kept?.document ?? (left?.opened.etag === opened.etag ? left.document : null);
    const at = this.trail.indexOf(key);
    if (at >= 0) this.trail.length = at;
    page.closeNet();
    this.mode?.close();
    $("ed-page").hidden = false;
    document.body.dataset.mode = "EDIT";
    $("mode").textContent = "EDIT";
    $("connection").hidden = true;
    const crumbs = this.trail.map((id) => [id, this.kept.get(id).opened.path]);
    this.mode = new EditMode(page, key, opened, { document: edited, crumbs });
    this.kept.set(key, { opened, document: this.mode.document });
    window.gspn = { page, edit: this.mode };
    this.showButtons();
    this.mode.addEventListener("frame", () => (document.body.dataset.ready = "0"), { once: true });
  }

  /** Open the file of a subnet; breadcrumbs lead back. */
  enter(key) {
    this.trail.push(this.id);
    this.page.edit(key);
  }

  /** Leave the mode; if there is unsaved work, ask first. Returns whether it was left. */
  async leave() {
    if (!this.mode) return true;
    const { unsaved } = this;
    const here = `#${encodeURIComponent(this.id)}&edit`;
    if (unsaved.length) {
      const { hash } = location;
      if (hash !== here) history.replaceState(null, "", here);
      const names = unsaved.map((key) => this.kept.get(key).opened.path);
      const { files } = this.mode;
      const only = unsaved.length === 1 && unsaved[0] === this.id;
      if (!(await mayLeave(names, only ? () => files.save() : null))) return false;
      history.replaceState(null, "", hash);
    }
    this.mode.close();
    this.mode = null;
    for (const [key, { opened, document: edited }] of this.kept) {
      edited.giveUp();
      this.left.set(key, { opened, document: edited });
    }
    this.kept.clear();
    this.trail = [];
    $("ed-page").hidden = true;
    this.showButtons();
    return true;
  }
}
