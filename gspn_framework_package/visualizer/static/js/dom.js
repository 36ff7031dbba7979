// Small helpers. Text from nets and robots is only ever inserted as text, never as markup.

const SVG = "http://www.w3.org/2000/svg";

export const $ = (id) => document.getElementById(id);

/** Fill an element. Its classes follow its name ("p.muted"); then come its attributes, which may be missing, and
 * its children: elements, texts, lists of them. */
function fill(create, selector, content) {
  const [name, ...classes] = selector.split(".");
  const element = create(name);
  if (classes.length) element.setAttribute("class", classes.join(" "));
  const named = content[0] && Object.getPrototypeOf(content[0]) === Object.prototype;
  const [attributes, ...children] = named ? content : [{}, ...content];
  for (const [key, value] of Object.entries(attributes)) {
    if (value === undefined || value === null || value === false) continue;
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (key === "text") element.textContent = value;
    else element.setAttribute(key, value === true ? "" : value);
  }
  element.append(...present(children));
  return element;
}

const present = (children) =>
  children.flat(Infinity).filter((child) => ![null, undefined, false, ""].includes(child));

/** Replace what is in an element; `children` as in `h`. */
export const refill = (element, ...children) => element.replaceChildren(...present(children));

export const h = (selector, ...content) =>
  fill((name) => document.createElement(name), selector, content);
export const s = (selector, ...content) =>
  fill((name) => document.createElementNS(SVG, name), selector, content);

/** The options of a menu: [value, text], or values that are their own texts. */
export const options = (choices) =>
  choices.map((choice) => {
    const [value, text = value] = [choice].flat();
    return h("option", { value, text });
  });

/** A menu; `choices`: as in `options`. */
export const menu = (choices, attributes = {}) => h("select", attributes, options(choices));

/** A field for a short text. */
export const textField = (attributes) =>
  h("input", { type: "text", spellcheck: "false", autocomplete: "off", ...attributes });

/** A label and its control, as two cells of a form. */
export const labelled = (label, control) => [h("label", { for: control.id, text: label }), control];

/** Mark a field as wrong for the reason in the element `why`; null: as right. */
export function markWrong(field, why) {
  for (const name of ["aria-invalid", "aria-describedby"]) field.removeAttribute(name);
  if (!why) return;
  field.setAttribute("aria-invalid", "true");
  field.setAttribute("aria-describedby", why.id);
}

/** A section that can be folded. */
export const question = (title, open, ...body) =>
  h("details.question", { open }, h("summary", title), h("div.body", body));

/** Names and values, one below the other; those without a value are left out. */
export const facts = (pairs) =>
  h(
    "dl.facts",
    pairs
      .filter((pair) => pair && (pair[1] ?? null) !== null)
      .map(([name, value]) => [h("dt", name), h("dd", value)]),
  );

/** The heads of columns of texts. */
export const columns = (heads) => heads.map((head) => h("th", { scope: "col" }, head));

/** A table; `kind`: its selector. Rows are lists of cells, or rows already; cells that are no cells yet are numbers,
 * but for the first of a row. */
export function table(kind, heads, rows) {
  const cellOf = (tag, cell, i) =>
    cell?.matches?.("td, th") ? cell : h(i ? `${tag}.number` : tag, cell);
  const rowOf = (tag, row) =>
    Array.isArray(row)
      ? h(
          "tr",
          row.map((cell, i) => cellOf(tag, cell, i)),
        )
      : row;
  const body = rows.map((row) => rowOf("td", row));
  return h(kind, h("thead", rowOf("th", heads)), h("tbody", body));
}

let toastTimer = 0;
export function toast(message, good = false) {
  const box = $("toast");
  box.textContent = message;
  box.className = good ? "toast good" : "toast";
  box.hidden = false;
  clearTimeout(toastTimer);
  toastTimer = setTimeout(
    () => {
      box.hidden = true;
    },
    good ? 3500 : 8000,
  );
}

export function announce(message) {
  $("announce").textContent = message;
}

/** Announce an urgent message: it interrupts the screen reader. */
export function announceNow(message) {
  $("announce-now").textContent = message;
}

let pressed = null; // the element that the pointer was pressed on
addEventListener(
  "pointerdown",
  (event) => {
    pressed = event.target;
  },
  true,
);
for (const end of ["pointerup", "pointercancel"])
  addEventListener(
    end,
    () =>
      setTimeout(() => {
        pressed = null;
      }),
    true,
  );

/** Whether the pointer is pressed on something inside an element, which would lose the click if it were redrawn. (A
 * press on the element itself is on its scroll bar, and not every browser reports its release.) */
export const isPressed = (element) =>
  pressed !== null && pressed !== element && element.contains(pressed);

/** Compares names in natural order: p2 comes before p10. */
const collator = new Intl.Collator("en", { numeric: true });
export const natural = (a, b) => collator.compare(a, b);

/** The index of the first item for which `holds` is true, as for all after it; the number of items if there is none. */
export function firstWhere(items, holds) {
  let [low, high] = [0, items.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (holds(items[middle])) high = middle;
    else low = middle + 1;
  }
  return low;
}

/** How far a key moves the choice in a list. */
export const LIST_STEPS = {
  ArrowDown: 1,
  ArrowUp: -1,
  PageDown: 10,
  PageUp: -10,
  Home: -Infinity,
  End: Infinity,
};

/** The tab to which an arrow key leads from `name`; undefined for another key. */
export function nextTab(event, names, name) {
  const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
  if (!step) return undefined;
  event.preventDefault();
  return names[(names.indexOf(name) + step + names.length) % names.length];
}

/** Runs an action and shows its error, if any. */
export async function attempt(action) {
  try {
    return await action();
  } catch (error) {
    toast(error.message);
    return null;
  }
}

/** The buttons of a dialog that can be cancelled. */
export const cancelOr = (label, value, kind = "primary") => [
  ["Cancel", ""],
  [label, value, kind],
];

/** Asks in a dialog; resolves to the value of the button pressed, or "" if it is closed. An error of `act(value)` is
 * shown in the dialog, which stays open and keeps the input. */
export function ask(title, content, buttons, act = null) {
  const dialog = $("dialog");
  const wrong = h("p.wrong", { role: "alert", hidden: true });
  const press = async (value) => {
    try {
      if (value && act) await act(value);
      dialog.close(value);
    } catch (error) {
      wrong.textContent = error.message;
      wrong.hidden = false;
    }
  };
  return new Promise((resolve) => {
    dialog.returnValue = "";
    dialog.replaceChildren(
      h("h2", { text: title, id: "dialog-title" }),
      h("div.content", { tabindex: "0" }, content), // focusable, so that keys scroll it
      wrong,
      h(
        "div.actions",
        buttons.map(([label, value, kind]) =>
          h("button", {
            class: kind || "",
            text: label,
            onclick: () => press(value),
            autofocus: /\bprimary\b/.test(kind || ""),
          }),
        ),
      ),
    );
    dialog.onkeydown = (event) => {
      if (event.key !== "Enter" || !event.target.matches("input")) return;
      event.preventDefault();
      dialog.querySelector(".actions .primary")?.click();
    };
    dialog.setAttribute("aria-labelledby", "dialog-title");
    dialog.onclose = () => resolve(dialog.returnValue);
    dialog.showModal();
  });
}

export const dialogOpen = () => $("dialog").open;

export function seconds(t) {
  if (t === null || t === undefined || !Number.isFinite(t)) return "";
  if (t < 60) return `${t.toFixed(t < 10 ? 2 : 1)} s`;
  const minutes = Math.floor(t / 60);
  const rest = String(Math.floor(t % 60)).padStart(2, "0");
  return minutes < 60
    ? `${minutes}:${rest}`
    : `${Math.floor(minutes / 60)}:${String(minutes % 60).padStart(2, "0")}:${rest}`;
}

/** The time of day of a Date. */
export const clock = (time) => time.toLocaleTimeString([], { hour12: false });

/** A word with "a" or "an" before it. */
export const withArticle = (word) => `${/^[aeiou]/i.test(word) ? "an" : "a"} ${word}`;

export const plural = (count, word) => `${count} ${word}${count === 1 ? "" : "s"}`;

export function number(value) {
  if (value === null || value === undefined) return "–";
  if (typeof value !== "number") return String(value);
  if (Number.isInteger(value)) return String(value);
  const size = Math.abs(value);
  return size !== 0 && (size < 0.001 || size >= 1e6)
    ? value.toExponential(3)
    : String(Number(value.toPrecision(5)));
}

/** A number with at most so many digits. */
export const rounded = (value, digits) => number(Number(value.toPrecision(digits)));

/** Resolves after so many ms. */
export const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
