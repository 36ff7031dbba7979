// The address of a moment of a run: it shows that moment to whoever opens it.

import { attempt, toast, pause } from "./dom.js";

/** Show the moment named in the address: `slot=12` is the state after slot 12 of the log, `t=83.5` that after 83.5 s
 * of the run. */
export async function goToMoment(page, word) {
  const found = /^(?:slot=([0-9]{1,15})|t=([0-9]{1,9}(?:\.[0-9]{1,6})?))$/.exec(word || "");
  const { model } = page;
  while (found && model && model === page.model) {
    const shown = await attempt(() =>
      found[1] ? model.showSlot(Number(found[1])) : model.showTime(Number(found[2])),
    );
    if (shown !== false) return;
    await pause(300); // the log is still being read
  }
}

/** Put the moment that is shown into the address, and copy that. */
export async function linkMoment({ session, board }) {
  const word = `#${encodeURIComponent(session.id)}&t=${Number(board.t.toFixed(4))}`;
  history.replaceState(null, "", word);
  const copied = await navigator.clipboard?.writeText(location.href).then(
    () => true,
    () => false,
  );
  toast(
    copied
      ? "The address of this moment was copied"
      : "The address of the page now names this moment",
    true,
  );
}
