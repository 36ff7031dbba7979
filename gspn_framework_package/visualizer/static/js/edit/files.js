// The files of the document: saving, conflicts with changes by somebody else, drafts, export.

import { $, h, ask, cancelOr, attempt, labelled, menu, textField, toast } from "../dom.js";
import { post, send } from "../api.js";
import { deployToARun } from "../deploy.js";
import { changeList, changesBetween } from "./diff_view.js";
import { pngOf, svgOf } from "./picture.js";

const QUIET = 1500; // ms without an edit after which the draft is stored
const AGAIN = 15_000; // ms before another attempt to store a draft
const CHANGED = 412; // status: the files have changed on the disk

/** Formats of the export: [name, description, file extension]. */
const FORMATS = [
  ["zip", "the plan's folder, in one file (zip)", ".zip"],
  ["svg", "a picture (SVG)", ".svg"],
  ["png", "a picture (PNG)", ".png"],
  ["pipe", "the net for PIPE (XML)", ".xml"],
  ["pnml", "the net as PNML", ".pnml"],
  ["pnpro", "the net for GreatSPN (PNPRO)", ".PNPRO"],
  ["tina", "the net for TINA", ".net"],
];

/** Have the browser save a file. */
function download(blob, name) {
  const address = URL.createObjectURL(blob);
  h("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 60_000);
}

/** A valid folder name for a plan or net of any name. */
const folderName = (name) =>
  name
    .replace(/[^\p{L}\p{N}_ .+-]+/gu, "_")
    .replace(/^[ .+-]+|[ .]+$/g, "")
    .slice(0, 80)
    .trim();

const moment = (text) => {
  const at = new Date(typeof text === "number" ? text * 1000 : text);
  return Number.isNaN(at.getTime()) ? String(text) : at.toLocaleString();
};

/** `mode.files`. */
export class Files {
  constructor(mode) {
    this.mode = mode;
    mode.files = this;
    this.timer = 0;
    this.saving = null;
    this.kept = null; // the state stored as the draft
    // the draft found on opening, until the user decides about it
    this.draft = mode.document.dirty ? null : mode.opened.draft || null;
    this.saveButton = mode.button("file", {
      id: "ed-save",
      label: "Save",
      key: "Ctrl+S",
      onclick: () => this.save(),
    });
    mode.button("file", { id: "ed-save-as", label: "Save as…", onclick: () => this.saveAs() });
    mode.button("file", { id: "ed-export", label: "Export…", onclick: () => this.exportDialog() });
    mode.button("file", {
      id: "ed-deploy",
      label: "Deploy…",
      title: "Deploy this plan, as last saved, to a running team",
      onclick: () => attempt(() => this.deploy()),
    });
    this.note = h("span.muted", { id: "ed-draft-state" });
    $("ed-foot").append(this.note);
    mode.onDocument(() => this.later(), "change", "saved");
    this.banner = h("div.ed-banner", { id: "ed-banner", hidden: true });
    $("ed-frame").before(this.banner);
    if (this.draft) this.offerDraft();
    else if (this.readOnly) this.tellReadOnly();
    this.refresh();
  }

  /** Why the document cannot be saved in its place; "" if it can. */
  get readOnly() {
    return this.mode.opened.read_only || "";
  }

  refresh() {
    const { document: edited } = this.mode;
    this.saveButton.disabled = !edited.dirty && !this.readOnly;
    this.saveButton.title = this.readOnly
      ? `It cannot be saved here: ${this.readOnly} (Ctrl+S saves it as a new plan)`
      : "Save (Ctrl+S)";
    if (!edited.dirty) this.note.textContent = "";
  }

  tellReadOnly() {
    this.showBanner(
      h("span", `It cannot be saved here: ${this.readOnly}.`),
      h("button", { text: "Save as…", onclick: () => this.saveAs() }),
      h("button", {
        text: "Close",
        "aria-label": "Close the note",
        onclick: () => this.hideBanner(),
      }),
    );
  }

  showBanner(...parts) {
    this.banner.replaceChildren(...parts);
    this.banner.hidden = false;
  }

  hideBanner() {
    this.banner.hidden = true;
    this.banner.replaceChildren();
  }

  request(what, body) {
    return post(`edit/${what}`, body, { id: this.mode.id });
  }

  // -- saving --------------------------------------------------------------------------------------

  /** Deploy the saved plan to a running team. */
  async deploy() {
    if (this.mode.document.dirty) throw new Error("save the changes first, then deploy the plan");
    await deployToARun({ path: this.mode.id.slice("file-".length) }, this.mode.id);
  }

  /** Save the document. Resolves to whether it was saved. */
  save() {
    if (!this.saving)
      this.saving = this.saveNow().finally(() => {
        this.saving = null;
      });
    return this.saving;
  }

  async saveNow() {
    if (this.readOnly) return this.saveAs();
    return this.tryToPut(this.mode.document.state, this.mode.opened.etag);
  }

  /** Save a state; if somebody else has changed the files, ask. Resolves to whether it was saved. */
  async tryToPut(state, etag) {
    try {
      await this.put(state, etag);
      return true;
    } catch (error) {
      if (error.status === CHANGED && error.data.theirs)
        return this.settle(state, error.data.theirs);
      toast(`Not saved: ${error.message}`);
      this.mode.say(`Not saved: ${error.message}`);
      return false;
    }
  }

  /** Write a state to the files if they still match `etag`. */
  async put(state, etag) {
    const { mode } = this;
    const saved = await this.request("save", { etag, document: state });
    Object.assign(mode.opened, { etag: saved.etag, draft: null });
    this.draft = null;
    this.hideBanner();
    mode.document.markSaved(state);
    mode.say(mode.document.dirty ? "Saved, except for the last edit." : "Saved.");
    toast("Saved", true);
  }

  /** The files have changed on the disk: ask which version to keep. Resolves to whether the user's version was saved.
   */
  async settle(state, theirs) {
    const { mode } = this;
    const list = h("div", h("p.muted", "Comparing …"));
    changesBetween(mode, theirs.document, state).then(
      (changes) => list.replaceChildren(changeList(changes)),
      (error) => list.replaceChildren(h("p", `Not compared: ${error.message}.`)),
    );
    const answer = await ask(
      "Somebody else has changed this plan",
      h(
        "div",
        { id: "ed-conflict" },
        h(
          "p",
          "The files have changed since you opened or saved them. Changes from their version to yours:",
        ),
        list,
      ),
      [
        ["Cancel", ""],
        ["Take theirs", "theirs"],
        ["Keep mine", "mine", "danger"],
      ],
    );
    if (answer === "mine") return this.tryToPut(state, theirs.etag);
    if (answer === "theirs") this.take(theirs);
    else mode.diff.show({ title: "From theirs to yours", from: theirs.document });
    return false;
  }

  /** Use the state of the files; undo restores the user's version. */
  take({ etag, document: theirs }) {
    const { mode } = this;
    mode.opened.etag = etag;
    mode.document.edit("Use the changed files", () => theirs);
    mode.document.markSaved();
    mode.say("These are the changed files. Undo restores your version.");
  }

  /** Save the document as a new plan and continue with that one. Resolves to whether it was saved. */
  async saveAs() {
    const { mode } = this;
    const { state } = mode.document;
    const name = textField({
      id: "ed-save-name",
      autofocus: true,
      value: this.readOnly ? folderName(state.plan?.plan || state.net.name || "") : "",
    });
    let found = null;
    await ask(
      "Save as a new plan",
      [
        this.readOnly && h("p", `It cannot be saved here: ${this.readOnly}.`),
        h("div.form", labelled("Name of the new folder", name)),
      ],
      cancelOr("Save", "save"),
      async () => {
        found = await this.request("save_as", { document: state, name: name.value.trim() });
      },
    );
    if (!found) return false;
    mode.document.markSaved(state);
    toast(`Saved as ${found.path}`, true);
    await attempt(() => this.request("draft", { etag: mode.opened.etag, document: null }));
    mode.page.edit(found.id);
    return true;
  }

  // -- drafts --------------------------------------------------------------------------------------

  later() {
    this.refresh();
    clearTimeout(this.timer);
    const { document: edited } = this.mode;
    if (!edited.dirty) {
      if (this.kept) this.dropDraft();
      return;
    }
    if (this.draft) {
      this.note.textContent = "No draft is stored until you decide about the one above";
      return;
    }
    this.note.textContent = "";
    this.timer = setTimeout(() => this.keepDraft(), QUIET);
  }

  async keepDraft() {
    clearTimeout(this.timer);
    const { mode } = this;
    const { state } = mode.document;
    if (!mode.document.dirty || state === this.kept || this.draft) return;
    try {
      await this.request("draft", { etag: mode.opened.etag, document: state });
      this.kept = state;
      if (state === mode.document.state && mode.document.dirty)
        this.note.textContent = `Draft stored at ${new Date().toLocaleTimeString()}`;
    } catch (error) {
      this.note.textContent = `The draft could not be stored: ${error.message}`;
      if (!this.closed) this.timer = setTimeout(() => this.keepDraft(), AGAIN);
    }
  }

  /** Delete the draft: its changes were saved or undone. */
  async dropDraft() {
    this.kept = null;
    try {
      await this.request("draft", { etag: this.mode.opened.etag, document: null });
    } catch {
      // if this fails, the draft is offered when the plan is opened again and can be discarded then
    }
  }

  offerDraft() {
    const { draft, mode } = this;
    const older = draft.etag !== undefined && draft.etag !== mode.opened.etag;
    const decide = (label, id, action) => h("button", { text: label, id, onclick: action });
    this.showBanner(
      h(
        "span",
        `A draft from ${moment(draft.saved_at)} was not saved.${older ? " The files have changed since." : ""}`,
      ),
      decide("Continue it", "ed-draft-continue", () => {
        this.draft = null;
        this.hideBanner();
        mode.diff.hide();
        mode.document.edit("Continue the draft", () => draft.document);
        if (older) mode.opened.etag = draft.etag; // saving it will ask about changes made since
        this.refresh();
      }),
      decide("Compare", "ed-draft-compare", () =>
        mode.diff.show({ title: "From the files to the draft", from: "saved", to: draft.document }),
      ),
      decide("Discard it", "ed-draft-discard", async () => {
        await attempt(() => this.dropDraft());
        this.draft = null;
        this.hideBanner();
        mode.diff.hide();
        this.later();
      }),
    );
  }

  // -- export --------------------------------------------------------------------------------------

  async exportDialog() {
    const format = menu(FORMATS, { id: "ed-export-format" });
    await ask(
      "Export",
      h("div.form", labelled("Export the document as", format)),
      cancelOr("Export", "export"),
      () => this.exportAs(format.value),
    );
  }

  async exportAs(format) {
    const { canvas, document: edited, opened } = this.mode;
    const ending = FORMATS.find(([name]) => name === format)[2];
    const own = edited.plan?.plan || edited.net.name || opened.path;
    const name = `${String(own).replace(/[^\w.-]+/g, "_")}${ending}`;
    if (format === "svg") download(new Blob([svgOf(canvas).text], { type: "image/svg+xml" }), name);
    else if (format === "png") download(await pngOf(canvas), name);
    else {
      const response = await send(
        "edit/export",
        { document: edited.state, format },
        { id: this.mode.id },
      );
      download(await response.blob(), name);
      const notes = JSON.parse(response.headers.get("X-Gspn-Notes") || "[]"); // what the format cannot express
      if (notes.length) toast(`Exported as ${name}. ${notes.join("; ")}.`);
    }
    this.mode.say(`Exported as ${name}.`);
  }

  close() {
    this.closed = true;
    clearTimeout(this.timer);
    if (!this.draft && !this.saving) this.keepDraft(); // edits made just before
  }
}
