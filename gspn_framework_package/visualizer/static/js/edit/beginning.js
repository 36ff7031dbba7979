// What an empty drawing shows: three ways to begin.

import { $, h, attempt } from "../dom.js";
import { newPlan } from "./new_plan.js";

export class Beginning {
  constructor(mode) {
    const { page, actions } = mode;
    const draw = () => {
      const key = actions.add("place", ...mode.canvas.freeSpot());
      if (key) mode.beginRename(key);
    };
    const copy = () =>
      attempt(async () => {
        const id = await newPlan(page.hello);
        if (id) page.edit(id);
      });
    const way = (id, label, said, onclick) =>
      h("li", h("button", { id, text: label, onclick }), h("span.muted", said));
    this.box = h(
      "div.ed-beginning",
      { id: "ed-beginning" },
      h("h2", "An empty net"),
      h(
        "ul",
        way("ed-begin-draw", "Draw the first place", "or double-click where it should be", draw),
        way(
          "ed-begin-template",
          "Start from a template …",
          "a plan that runs, to be changed",
          copy,
        ),
        way("ed-begin-open", "Open another net …", "of this folder or of another tool", () =>
          page.openScreen(true),
        ),
      ),
    );
    $("ed-frame").append(this.box);
    const show = () => {
      const { places, transitions } = mode.document.net;
      this.box.hidden = places.length + transitions.length > 0;
    };
    mode.onDocument(show, "change");
    show();
  }
}
