// Menus and completions. A thousand options take a browser longer than the rest of a form, so those of a long list are
// made when the user reaches the control.

import { h } from "../dom.js";

const SHORT = 30; // number of options made at once

const option = ({ value, text, selected }) => h("option", { value, text, selected });

/** Call `act` once, before the user can open the menu or the completions of a control. */
function whenUsed(control, act) {
  const ends = new AbortController();
  const { signal } = ends;
  for (const event of ["pointerdown", "focus"])
    control.addEventListener(
      event,
      () => {
        ends.abort();
        act();
      },
      { signal },
    );
}

/** A select with `entries`: [{value, text, selected}, ...]. */
export function selectOf(attributes, entries) {
  const select = h("select", attributes);
  if (entries.length <= SHORT) select.append(...entries.map(option));
  else {
    select.append(option(entries.find(({ selected }) => selected) ?? entries[0]));
    whenUsed(select, () => select.replaceChildren(...entries.map(option)));
  }
  return select;
}

/** The completions of a field. */
export function completionsOf(input, id, given) {
  const names = [...new Set(given)];
  const list = h("datalist", { id });
  const fill = () => list.append(...names.map((value) => h("option", { value })));
  if (names.length <= SHORT) fill();
  else whenUsed(input, fill);
  input.setAttribute("list", id);
  return list;
}

/** Call `act(value)` when the user chooses an entry of a menu that otherwise shows "". Arrow keys and letters on the
 * closed menu only move to an entry, which Enter chooses; browsers would report each entry on the way as chosen. */
export function actOnChoice(menu, act) {
  let looking = false;
  const rest = () => {
    looking = false;
    menu.value = "";
  };
  const take = () => {
    const { value } = menu;
    rest();
    if (value !== "") act(value);
  };
  menu.addEventListener("keydown", (event) => {
    const { key, altKey, ctrlKey, metaKey } = event;
    if (ctrlKey || metaKey || ["Alt", "Shift", "Tab"].includes(key)) return;
    if (key === "Enter" && looking && menu.value !== "") {
      event.preventDefault();
      take();
    } else if (altKey || ["Enter", " ", "Escape"].includes(key)) rest();
    else looking = true;
  });
  menu.addEventListener("pointerdown", rest);
  menu.addEventListener("blur", rest);
  menu.addEventListener("change", () => !looking && take());
}
