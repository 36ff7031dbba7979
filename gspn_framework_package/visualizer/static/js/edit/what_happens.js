// "What would happen here?": which row of the policy applies to the robots of each place in the marking shown, and
// which transitions they would choose.

import { h, number } from "../dom.js";
import { post } from "../api.js";

const PLACES = 80; // number of places that get a field for their tokens

export class WhatHappens {
  constructor(mode) {
    this.mode = mode;
    this.page = Math.random().toString(36).slice(2);
    this.asked = 0;
    this.result = h("div", { id: "ed-here", "aria-live": "polite" });
    this.fields = h("div.ed-tokens.form");
    this.other = h("details", h("summary", "Another marking"), this.fields);
    this.other.addEventListener("toggle", () => this.other.open && this.showFields());
    mode.panel(
      "here",
      "What happens",
      h(
        "div",
        h(
          "p.muted",
          "Which row of the policy applies in the marking shown, and what robots would choose.",
        ),
        h("button.primary", {
          id: "ed-here-ask",
          text: "What would happen here?",
          onclick: () => this.ask(),
        }),
        this.other,
        this.result,
      ),
    );
    this.button = mode.button("look", {
      id: "ed-here-open",
      label: "What happens",
      title: "Which row of the policy applies in the marking shown",
      onclick: () => {
        mode.showPanel("here");
        return this.ask();
      },
    });
    mode.onDocument(() => this.clear(), "change");
  }

  /** The marking typed by the user, or the one on the drawing: of a witness, or the initial one. */
  marking() {
    const { places } = this.mode.document.net;
    const typed = new Map(
      this.other.open
        ? [...this.fields.querySelectorAll("input")].map((f) => [f.dataset.place, Number(f.value)])
        : [],
    );
    const shown = this.mode.canvas.counts;
    const tokens = ({ name, tokens: own = 0 }) => typed.get(name) ?? shown?.get(name) ?? own;
    return Object.fromEntries(places.map((place) => [place.name, tokens(place)]));
  }

  showFields() {
    const { places } = this.mode.document.net;
    const shown = this.mode.canvas.counts;
    this.fields.replaceChildren(
      ...places.slice(0, PLACES).flatMap(({ name, tokens = 0 }, i) => [
        h("label", { for: `ed-here-${i}`, text: name }),
        h("input", {
          id: `ed-here-${i}`,
          type: "number",
          min: 0,
          step: 1,
          value: String(shown?.get(name) ?? tokens),
          "data-place": name,
          onchange: () => this.ask(),
        }),
      ]),
    );
  }

  /** The document has changed: the last answer may be wrong now. */
  clear() {
    this.asked += 1;
    this.result.replaceChildren();
    if (this.other.open) this.showFields();
  }

  async ask() {
    this.asked += 1;
    const { asked } = this;
    const body = {
      document: this.mode.document.state,
      marking: this.marking(),
      page: this.page,
    };
    this.result.replaceChildren(h("p.muted", "Looking …"));
    try {
      const answer = await post("edit/choices", body, { id: this.mode.id });
      if (asked === this.asked && !answer.cancelled) this.show(answer);
    } catch (error) {
      if (asked === this.asked) this.result.replaceChildren(h("p", `Not known: ${error.message}.`));
    }
  }

  show({ places, enabled, over }) {
    const chance = ({ name, probability, enabled: on, why }) =>
      h(
        "li",
        { class: on ? "" : "muted" },
        `${name}${probability === null ? "" : ` ${number(Math.round(1000 * probability) / 10)} %`}`,
        on ? "" : ` – ${why.join("; ") || "not enabled"}`,
      );
    this.result.replaceChildren(
      over ? h("p", "The run ends here: “until” holds.") : "",
      places.length ? "" : h("p", "There is no robot in any place."),
      ...places.map((place) =>
        h(
          "section",
          { "data-place": place.place },
          h("h2", `${place.place} (${place.tokens})`),
          h("p", `${place.why}.`),
          h("ul", place.transitions.map(chance)),
        ),
      ),
      h(
        "p.muted",
        enabled.length ? `Enabled: ${enabled.join(", ")}.` : "No transition is enabled.",
      ),
    );
  }

  close() {
    this.asked += 1;
  }
}
