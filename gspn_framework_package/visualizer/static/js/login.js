// Logging in, where the server asks for a token.

import { ask, attempt, h } from "./dom.js";
import { get, post } from "./api.js";

/** Log in if the server wants it. A token in the address after # is used and removed. */
export async function login() {
  const found = /[#&]token=([^&]+)/.exec(location.hash);
  if (found) {
    history.replaceState(null, "", location.pathname);
    await attempt(() => post("login", { token: decodeURIComponent(found[1]) }));
    return;
  }
  try {
    await get("hello");
  } catch (error) {
    if (error.status !== 401) return;
    const field = h("input", { type: "password", "aria-label": "Token", autocomplete: "off" });
    await ask(
      "This page needs a token",
      [h("p.muted", "It was printed where the server was started."), field],
      [["Continue", "go", "primary"]],
    );
    await attempt(() => post("login", { token: field.value }));
    await login();
  }
}
