// A bar above the net for events that the user must know about and can act on: a cut-off run, a restarted server. It
// stays until it or the net is closed.

import { $, h } from "./dom.js";

const bar = h("div.notice", { id: "notice", role: "alert", hidden: true });

/** Show `text`; `actions` are pairs [label, function]. */
export function notice(text, actions = []) {
  $("tools").after(bar);
  bar.hidden = false;
  bar.replaceChildren(
    h("span.what-is", text),
    ...actions.map(([label, act]) => h("button", { text: label, onclick: act })),
    h("button.icon.small", {
      "aria-label": "Close this notice",
      text: "×",
      onclick: closeNotice,
    }),
  );
}

export function closeNotice() {
  bar.hidden = true;
  bar.replaceChildren();
}
