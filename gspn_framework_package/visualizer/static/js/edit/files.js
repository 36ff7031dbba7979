// The files of the document: saving, conflicts with changes by somebody else, drafts, export.

import { $, h, ask, cancelOr, attempt, labelled, menu, textField, toast, pause } from "../dom.js";
import { get, post, send } from "../api.js";
import { deployToARun } from "../deploy.js";
import { hasUnsaved } from "./editor.js";
import { changeList, changesBetween } from "./diff_view.js";
import { packedHistory, unpackedHistory } from "./history.js";
import { conflictText, merged, same } from "./merge.js";
import { download, pngOf, svgOf } from "./picture.js";

const QUIET = 1500; // ms without an edit after which the draft is stored
const SOON = 300; // the same while somebody else edits the plan, who sees the draft
const REST = 100; // ms between two checks whether a gesture has ended
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
    this.line = Promise.resolve(); // requests that change or read the latest version run one after the other
    const { opened } = mode;
    opened.common ??= opened.document; // the state in the version that the server and this page have in common
    opened.version ??= opened.etag;
    opened.savedEtag ??= opened.etag; // the hash of the files that `document.saved` is the content of
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

  /** Run `act` once the requests before it have been answered. */
  inLine(act) {
    const done = this.line.then(act);
    this.line = done.catch(() => {});
    return done;
  }

  /** The fields of a request that describe the state that it sends. */
  basis(etag = this.mode.opened.etag) {
    return { etag, version: this.mode.opened.version, page: this.mode.visit };
  }

  /** The sources of functions that are typed and not written yet: name -> {file, version, text}. */
  get sources() {
    return (this.mode.opened.sources ??= {});
  }

  /** Keep such a source with the draft; without one, there is nothing left to write. */
  keepSource(name, source) {
    if (source) this.sources[name] = source;
    else delete this.sources[name];
    this.later();
  }

  /** Whether the server has a draft. */
  get stored() {
    const { opened } = this.mode;
    return opened.version !== opened.etag;
  }

  // -- changes of somebody else ----------------------------------------------------------------------

  /** Resolves once no gesture or name is unfinished. */
  async rest() {
    while (!this.closed && (this.mode.pointer.gesture || this.mode.renaming)) await pause(REST);
  }

  /** Fetch the latest version and merge it. */
  follow() {
    return this.inLine(async () => {
      const latest = await get("edit/latest", { id: this.mode.id });
      if (this.closed || latest.version === this.mode.opened.version) return;
      await this.rest();
      if (!this.closed) this.take(latest);
    });
  }

  /** Merge the server's latest version. Returns what both changed. */
  take({ version, etag, document: theirs, draft }) {
    const { opened, document: edited } = this.mode;
    const [base, mine] = [opened.common, edited.state];
    const { state, conflicts, taken } = merged(base, mine, theirs);
    if (this.draft) {
      this.draft = null;
      this.hideBanner();
    }
    Object.assign(opened, { version, etag, common: theirs });
    edited.follow(state);
    if (!draft) {
      opened.savedEtag = etag;
      edited.markSaved(same(state, theirs) ? state : theirs);
    }
    this.mode.together?.tell({ base, mine, theirs, state, conflicts, taken });
    this.later();
    return conflicts;
  }

  // -- saving --------------------------------------------------------------------------------------

  /** Deploy the saved plan to a running team. */
  async deploy() {
    if (this.mode.document.dirty) throw new Error("save the changes first, then deploy the plan");
    await deployToARun({ path: this.mode.id.slice("file-".length) }, this.mode.id);
  }

  /** Save the document. Resolves to whether it was saved. */
  save() {
    if (this.readOnly) return this.saveAs();
    if (!this.saving)
      this.saving = this.inLine(() => this.saveNow()).finally(() => {
        this.saving = null;
      });
    return this.saving;
  }

  saveNow() {
    return this.tryToPut(this.mode.document.state, this.mode.opened.etag);
  }

  /** Save a state; if somebody else has changed the files, ask. Resolves to whether it was saved. */
  async tryToPut(state, etag) {
    try {
      await this.put(state, etag);
      return true;
    } catch (error) {
      const theirs = error.status === CHANGED && error.data.theirs;
      if (theirs?.draft) {
        if (!this.take(theirs).length)
          return this.tryToPut(this.mode.document.state, this.mode.opened.etag);
        this.mode.say(
          "Not saved: both of you changed the same parts. Review them, then save again.",
        );
        return false;
      }
      if (theirs) return this.settle(state, theirs);
      toast(`Not saved: ${error.message}`);
      this.mode.say(`Not saved: ${error.message}`);
      return false;
    }
  }

  /** Write a state to the files if they still match `etag`. */
  async put(state, etag) {
    const { mode } = this;
    const saved = await this.request("save", { ...this.basis(etag), document: state });
    Object.assign(mode.opened, {
      etag: saved.etag,
      savedEtag: saved.etag,
      version: saved.etag,
      common: state,
      draft: null,
      keptSources: "{}",
    });
    this.draft = null;
    this.hideBanner();
    mode.document.markSaved(state);
    mode.say(mode.document.dirty ? "Saved, except for the last edit." : "Saved.");
    toast("Saved", true);
  }

  /** The files have changed on the disk: merge both and save that; if both changed the same, ask first. Resolves to
   * whether the user's version was saved. */
  async settle(own, theirs) {
    const { mode } = this;
    const { opened, document: edited } = mode;
    const known = opened.savedEtag === opened.etag;
    const both = known ? merged(edited.saved, own, theirs.document) : { state: own, conflicts: [] };
    const { state } = both;
    if (known && !both.conflicts.length) {
      this.useFiles(theirs);
      edited.follow(merged(own, edited.state, state).state);
      edited.markSaved(theirs.document);
      return this.tryToPut(edited.state, theirs.etag);
    }
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
        both.conflicts.length > 0 && [
          h("p", "Both of you changed:"),
          h(
            "ul",
            both.conflicts.map((conflict) => h("li", conflictText(conflict))),
          ),
        ],
        list,
      ),
      [
        ["Cancel", ""],
        ["Take theirs", "theirs"],
        ["Keep mine", "mine", "danger"],
      ],
    );
    if (answer === "mine") return this.tryToPut(state, theirs.etag);
    if (answer === "theirs") this.replace(theirs);
    else mode.diff.show({ title: "From theirs to yours", from: theirs.document });
    return false;
  }

  /** Use the state of the files; undo restores the user's version. */
  replace(theirs) {
    const { mode } = this;
    this.useFiles(theirs);
    mode.document.edit("Use the changed files", () => theirs.document);
    mode.document.markSaved();
    mode.say("These are the changed files. Undo restores your version.");
  }

  /** The files have another content, of which the page knows. */
  useFiles({ etag, document: content }) {
    const { opened } = this.mode;
    if (!this.stored) Object.assign(opened, { version: etag, common: content });
    Object.assign(opened, { etag, savedEtag: etag });
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
    await attempt(() => this.dropDraft());
    mode.page.edit(found.id);
    return true;
  }

  // -- drafts --------------------------------------------------------------------------------------

  later() {
    this.refresh();
    clearTimeout(this.timer);
    const alone = !this.mode.together?.others.length;
    if (!hasUnsaved(this.mode) && alone) {
      if (this.stored && !this.draft) this.dropDraft();
      return;
    }
    if (this.draft) {
      this.note.textContent = "No draft is stored until you decide about the one above";
      return;
    }
    this.note.textContent = "";
    this.timer = setTimeout(() => this.keepDraft(), alone ? QUIET : SOON);
  }

  keepDraft() {
    clearTimeout(this.timer);
    return this.inLine(() => this.keepNow(this.mode.document.state));
  }

  async keepNow(state) {
    const { mode } = this;
    const { opened } = mode;
    const sources = JSON.stringify(this.sources);
    const typed = sources !== (opened.keptSources ?? "{}");
    if ((state === opened.common && !typed) || this.draft) return;
    if (same(state, opened.common) && !typed) {
      opened.common = state;
      return;
    }
    try {
      const history = { ...packedHistory(mode.document, state), sources: JSON.parse(sources) };
      const sent = { ...this.basis(), document: state, history };
      const { version } = await this.request("draft", sent);
      Object.assign(opened, { version, common: state, keptSources: sources });
      if (state === mode.document.state && hasUnsaved(mode))
        this.note.textContent = `Draft stored at ${new Date().toLocaleTimeString()}`;
    } catch (error) {
      if (error.status === CHANGED && error.data.theirs) {
        await this.rest();
        if (this.closed) await this.keepMerged(state, error.data.theirs);
        else this.take(error.data.theirs);
        return;
      }
      this.note.textContent = `The draft could not be stored: ${error.message}`;
      if (!this.closed) this.timer = setTimeout(() => this.keepDraft(), AGAIN);
    }
  }

  /** The page has left the document, and the server has a later version: send both, merged. */
  keepMerged(state, { version, etag, document: theirs }) {
    const { opened } = this.mode;
    const both = merged(opened.common, state, theirs).state;
    Object.assign(opened, { version, etag, common: theirs });
    return this.keepNow(both);
  }

  /** Delete the draft: its changes were saved or undone. */
  dropDraft() {
    return this.inLine(async () => {
      const { opened, document: edited } = this.mode;
      const version = this.draft?.version ?? opened.version;
      try {
        const sent = { ...this.basis(), version, document: null };
        const { kept } = await this.request("draft", sent);
        if (!kept) Object.assign(opened, { version: opened.etag, common: edited.saved });
      } catch {
        // if this fails, the draft is offered when the plan is opened again and can be discarded then
      }
    });
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
        this.continueDraft(draft);
        Object.assign(mode.opened, { version: draft.version, common: draft.document });
        if (older) mode.opened.etag = draft.etag; // saving it will ask about changes made since
        this.refresh();
      }),
      decide("Compare", "ed-draft-compare", () =>
        mode.diff.show({ title: "From the files to the draft", from: "saved", to: draft.document }),
      ),
      decide("Discard it", "ed-draft-discard", async () => {
        await this.dropDraft();
        this.draft = null;
        this.hideBanner();
        mode.diff.hide();
        this.later();
        await attempt(() => this.follow()); // somebody else may work on it: then it stays
      }),
    );
  }

  /** Continue with a draft and its history; without one, undo restores the content of the files. */
  continueDraft({ document: drafted, history }) {
    const { document: edited, opened } = this.mode;
    opened.sources = history?.sources ?? {};
    opened.keptSources = JSON.stringify(opened.sources);
    this.mode.dispatchEvent(new CustomEvent("functions"));
    if (same(edited.state, drafted)) return;
    if (history?.done.length) edited.restore(drafted, unpackedHistory(history, drafted));
    else edited.edit("Continue the draft", () => drafted);
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
    const { state } = this.mode.document; // edits made just before
    if (!this.draft && !this.saving && hasUnsaved(this.mode))
      this.inLine(() => this.keepNow(state));
  }
}
