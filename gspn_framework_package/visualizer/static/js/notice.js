// A bar above the net for events that the user must know of and may act on: a run that was cut off, a server that was
// restarted. It stays until it is closed or the net is.

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
