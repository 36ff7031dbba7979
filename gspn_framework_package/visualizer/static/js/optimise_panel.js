// The Optimise tab: asks the server for the best policy, compares it with the present one, and saves it if the operator
// accepts. It never replaces anything unasked.

import {
  $,
  h,
  announce,
  ask,
  attempt,
  labelled,
  markWrong,
  question,
  refill,
  textField,
  toast,
} from "./dom.js";
import { get, post } from "./api.js";
import { deployToARun } from "./deploy.js";
import { BackgroundJob } from "./jobs.js";
import { nodeLink } from "./net_marks.js";
import { OptimiseForm } from "./optimise_form.js";
import { ChoiceList, ChoicePainter, OptimiseViews, markingText } from "./optimise_views.js";
import { PolicyTable, choiceText } from "./policy_table.js";

const FOLLOW = 150; // ms between two updates for the marking shown

/** Fires "choose" (detail {kind, index, fly}) and "saved" (detail {path, open}). */
export class OptimisePanel extends EventTarget {
  /** `refusal`: why no policy can be computed or saved; "" if one can. */
  constructor(model, view, refusal = "") {
    super();
    this.model = model;
    this.refusal = refusal;
    this.panel = $("optimise");
    this.panel.replaceChildren();
    this.view = view;
    this.painter = new ChoicePainter(view);
    const choose = (detail) => this.dispatchEvent(new CustomEvent("choose", { detail }));
    this.views = new OptimiseViews((name) => nodeLink(model.scene, name, choose));
    this.status = h("div.answer", { role: "status" });
    this.answers = h("div", { id: "optimised" });
    this.job = new BackgroundJob(model.session, this.status, "op-cancel");
    this.shown = null; // the key of the answer that is shown
  }

  /** The tab is opened; its content is built the first time. */
  open() {
    if (!this.built) this.build();
    if (this.refusal && this.model.scene.plan) this.showLatest();
  }

  build() {
    this.built = true;
    const show = (text, ...parts) => refill(this.panel, h("p.muted", text), parts);
    if (!this.model.scene.plan) {
      show("A policy needs a plan. This is a net without robots and actions.");
      return;
    }
    if (this.refusal) {
      show(`Policies cannot be computed here: ${this.refusal}.`, this.status, this.answers);
      return;
    }
    this.form = new OptimiseForm(this.model);
    const start = { id: "op-start", text: "Optimise", onclick: () => this.optimise() };
    show(
      "Computes the best policy for an aim. Nothing is changed until you save it.",
      this.form.element,
      h("div.buttons", h("button.primary", start)),
      this.status,
      this.answers,
    );
  }

  // -- asking ----------------------------------------------------------------------------------------

  async optimise() {
    if (this.job.running) {
      toast("a policy is being computed: wait for it or cancel it", true);
      return;
    }
    this.form.clear();
    this.discard();
    const body = this.form.read();
    try {
      const report = await this.job.run(body, { most: body.limit });
      if (report?.state === "done" && report.result) this.show(report);
    } catch (error) {
      const { fields } = error.data || {};
      if (fields) this.form.tell(fields);
      const badge = h("span.badge.bad", "not started");
      this.status.replaceChildren(h("p", { "data-state": "refused" }, badge, ` ${error.message}`));
    }
  }

  /** For read-only viewers: the latest answer that the server has for this plan. */
  async showLatest() {
    const { model } = this;
    const latest = await get("optimised", { id: model.session.id }).catch(() => null);
    if (!latest?.job) {
      if (!this.shown) this.status.replaceChildren(h("p", "No policy has been computed yet."));
      return;
    }
    if (latest.job === this.shown) return;
    const report = await attempt(() => get(`analysis/${latest.job}`));
    if (!report?.result) return;
    this.status.replaceChildren(h("p", "The operator's latest answer:"));
    this.show({ ...report, key: latest.job });
  }

  // -- the answer ------------------------------------------------------------------------------------

  show(report) {
    const answer = report.result.optimised;
    this.shown = report.key;
    this.choices = new ChoiceList(answer, ({ marking, place, present, best }) => {
      this.stopFollowing();
      this.painter.paint([{ place, present, best }], `When ${markingText(marking)}`);
      const index = this.model.scene.places.findIndex(({ name }) => name === place);
      if (index >= 0) this.view.flyTo("place", index);
      announce(`${place}: present ${choiceText(present)}, best ${choiceText(best)}`);
    });
    const rows = new PolicyTable(report.key, (marking, choose, title) => {
      this.stopFollowing();
      this.choices.clear();
      this.painter.paint(this.asChoices(choose), title);
    });
    const table = question("Policy", false, rows.element);
    table.addEventListener("toggle", () => table.open && rows.start === undefined && rows.show());
    refill(
      this.answers,
      this.views.result(answer),
      this.keeping(report),
      this.views.constraints(answer),
      this.choices.element,
      table,
      this.views.teams(answer),
      this.views.sensitivities(answer),
      this.views.assumptions(answer),
    );
    this.choices.element.querySelector(".body").prepend(this.following());
    this.answers.scrollIntoView({ block: "nearest" });
  }

  /** The choices of a row, by the places they leave. */
  asChoices(choose) {
    const { places, transitions, arcs } = this.model.scene;
    const found = new Map();
    for (const [name, probability] of Object.entries(choose)) {
      const t = transitions.findIndex((transition) => transition.name === name);
      for (const [p, , , , inhibitor] of arcs.filter(([, to, forth]) => to === t && forth)) {
        if (inhibitor || places[p].kind !== "action") continue;
        if (!found.has(p)) found.set(p, { place: places[p].name, present: null, best: {} });
        found.get(p).best[name] = probability;
      }
    }
    return [...found.values()];
  }

  // -- the marking shown --------------------------------------------------------------------------

  /** The button that shows the choices in the marking shown, and follows it. */
  following() {
    this.here = h("p.muted", { hidden: true });
    this.follow = h("button", {
      id: "op-follow",
      "aria-pressed": "false",
      text: "Follow the marking shown",
      onclick: () => {
        if (this.follow.getAttribute("aria-pressed") === "true") {
          this.stopFollowing();
          this.painter.clear();
        } else {
          this.choices.clear();
          this.follow.setAttribute("aria-pressed", "true");
          this.look(true);
        }
      },
    });
    return h("div", h("div.buttons", this.follow), this.here);
  }

  stopFollowing() {
    this.follow?.setAttribute("aria-pressed", "false");
    if (this.here) this.here.hidden = true;
  }

  /** The board has changed. */
  later() {
    if (this.follow?.getAttribute("aria-pressed") !== "true" || this.timer) return;
    this.timer = setTimeout(() => {
      this.timer = 0;
      this.look();
    }, FOLLOW);
  }

  /** Show the choices in the marking shown. `first`: the user has just asked for them. */
  async look(first = false) {
    const { model, shown } = this;
    if (!first && !this.painter.on) {
      this.stopFollowing(); // something else is highlighted, or the marks were cleared
      return;
    }
    const at = model.board.n;
    const answer = await get(`analysis/${shown}/choices`, { id: model.session.id, at }).catch(
      (error) => ({ error: error.message }),
    );
    if (this.shown !== shown || this.follow.getAttribute("aria-pressed") !== "true") return;
    if (answer.error) {
      this.stopFollowing();
      toast(answer.error);
      return;
    }
    this.painter.paint(answer.choices, "The marking shown");
    this.here.hidden = false;
    this.here.textContent = answer.choices.length
      ? answer.choices
          .map(
            ({ place, present, best }) =>
              `${place}: now ${choiceText(present)}, best ${choiceText(best)}`,
          )
          .join("; ")
      : "No robot has a choice in this marking.";
    if (model.board.n !== at) this.later();
  }

  // -- saving it ----------------------------------------------------------------------------------------

  keeping(report) {
    const { session } = this.model;
    const name = textField({
      id: "op-name",
      value: report.saves_as || "",
      oninput: () => this.tellSaving(""),
    });
    this.saving = h("p", { id: "op-saving", role: "status", hidden: true });
    const refusal = this.refusal || (session.saves ? "" : "the plan is not a file of this server");
    return h(
      "section.question.keeping",
      { "aria-label": "Keep or discard" },
      h(
        "div.body",
        refusal
          ? h("p.muted", `The plan cannot be saved here: ${refusal}.`)
          : [
              h(
                "p.muted",
                "Saves the plan with the new policy as a new file next to the present one, which is not changed.",
              ),
              h("div.form", labelled("Save as", name)),
            ],
        this.saving,
        h(
          "div.buttons",
          !refusal &&
            h("button.primary", {
              id: "op-save",
              text: "Accept and save",
              onclick: () => this.save(report.key, name),
            }),
          h("a.button", {
            id: "op-download",
            href: `/api/analysis/${report.key}/plan`,
            download: "plan_optimised.json",
            text: "Download",
          }),
          h("button", {
            id: "op-deploy",
            text: "Deploy to the team…",
            title: this.refusal || "Make the running team follow the plan with this policy",
            disabled: Boolean(this.refusal),
            onclick: () => attempt(() => deployToARun({ job: report.key }, session.id)),
          }),
          h("button", { id: "op-discard", text: "Discard", onclick: () => this.discard(true) }),
        ),
      ),
    );
  }

  /** Show the result of saving; `wrong`: what is wrong with the name. */
  tellSaving(text, wrong = false, ...more) {
    const name = $("op-name");
    this.saving.hidden = !text;
    this.saving.className = wrong ? "wrong" : "";
    this.saving.replaceChildren(text, ...more);
    markWrong(name, wrong && this.saving);
    if (wrong) name.focus();
  }

  async save(key, name) {
    const file = name.value.trim();
    let saved = null;
    try {
      saved = await post(`analysis/${key}/save`, { name: file });
    } catch (error) {
      if (!error.data?.exists) {
        this.tellSaving(error.message, true);
        return;
      }
      const answer = await ask(
        "Replace the file?",
        [
          h("p", "The file ", h("strong", file), " exists already."),
          h("p", "If you replace it, its plan is lost."),
        ],
        [
          ["Keep it", "", "primary"],
          ["Replace it", "replace", "danger"],
        ],
        async () => {
          saved = await post(`analysis/${key}/save`, { name: file, overwrite: true });
        },
      );
      if (answer !== "replace" || !saved) {
        this.tellSaving("Nothing was saved. Choose another name.", true);
        return;
      }
    }
    const { path } = saved;
    this.tellSaving(
      `Saved as ${saved.name}. The present plan is unchanged. `,
      false,
      path
        ? h("button", {
            id: "op-open",
            text: "Open the new plan",
            onclick: () => this.tellSaved(path, true),
          })
        : "",
    );
    this.tellSaved(path, false);
  }

  tellSaved(path, open) {
    this.dispatchEvent(new CustomEvent("saved", { detail: { path, open } }));
  }

  /** Discard the answer shown. `asked`: the user requested it. */
  discard(asked = false) {
    this.stopFollowing();
    this.painter.clear();
    this.shown = null;
    this.answers.replaceChildren();
    if (!asked) return;
    this.status.replaceChildren(h("p.muted", "Discarded. Nothing was changed."));
    $("op-start")?.focus();
  }

  close() {
    clearTimeout(this.timer);
    this.job.close();
    this.painter.clear();
  }
}
