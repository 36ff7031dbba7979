// The keyboard shortcuts of the page, and their table.

import { $, h, ask, attempt, dialogOpen } from "./dom.js";
import { EDIT_KEYS } from "./edit/edit_keys.js";

/** The tabs of the details, in their order. */
export const TABS = ["inspector", "robots", "analysis", "optimise"];

const TABLE = [
  ["Space", "pause the view, play; run and stop a simulation"],
  ["→  ←", "one step forward, one step back"],
  ["Shift + →", "n steps"],
  ["X", "fire the selected transition"],
  ["R", "reset the simulation, for all viewers; ← undoes it"],
  ["E", "highlight what is enabled, on and off"],
  ["L", "back to live"],
  ["F", "fit the net"],
  ["+  −", "zoom"],
  ["/", "search; then ↓ and Enter move through the list"],
  ["Shift + Enter", "in the list: fire"],
  ["1  2  3  4", "inspector, robots, analysis, optimise"],
  ["P  D  T", "fold and unfold: places and transitions, details, time line"],
  ["W", "more room for the details"],
  ["O", "open another net"],
  ["Esc", "clear the selection"],
];

const SYMBOLS = [
  [
    "circle",
    "a place; dots are tokens, up to 9, then a number; coloured discs are robots with their number",
  ],
  ["dashed circle", "a resource place: its tokens are counters"],
  ["thin bar", "an immediate transition"],
  ["open box", "an exponential transition"],
  ["green, with a triangle above", "enabled"],
  ["red dashed line with a small circle", "an inhibitor arc"],
  ["number on an arc", "its weight, if it is not 1"],
];

/** Show the keys of the page, or those of its editor. */
export function showHelp(editing = false) {
  return ask(
    "Keys and symbols",
    [
      h(
        "table",
        h(
          "tbody",
          (editing ? EDIT_KEYS : TABLE).map(([key, says]) =>
            h("tr", h("td", h("kbd", key)), h("td", says)),
          ),
        ),
      ),
      h("h3", "In the net"),
      h(
        "table",
        h(
          "tbody",
          SYMBOLS.map(([sign, says]) => h("tr", h("td", sign), h("td", says))),
        ),
      ),
    ],
    [["Close", "", "primary"]],
  );
}

/** Bind the keys. They act unless a field, a dialog or a button that uses them has the focus. */
export function bindKeys(page) {
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || dialogOpen()) return;
    const target = event.target;
    if (target.matches("input:not([type=checkbox]):not([type=range]), textarea, select")) return;
    const onButton =
      target.matches("button, summary, [role=tab]") && (event.key === " " || event.key === "Enter");
    if (onButton) return;
    if (target.matches("input[type=range], [role=tab]") && event.key.startsWith("Arrow")) return;
    const action = actionOf(event, page);
    if (!action) return;
    event.preventDefault();
    attempt(action);
  });
}

function actionOf(event, page) {
  const { model, tools, view } = page;
  if (event.key === "?") return () => showHelp(Boolean(page.editor.mode));
  if (!model || !model.board) return null;
  const simulating = model.mode === "SIMULATE";
  switch (event.key) {
    case " ":
      return () =>
        simulating
          ? model.following
            ? tools.toggleRunning()
            : page.togglePause()
          : page.togglePause();
    case "ArrowRight":
      if (simulating && model.following) return () => tools.step(event.shiftKey ? tools.steps : 1);
      return async () => {
        for (let i = 0; i < (event.shiftKey ? tools.steps : 1); i++) await model.stepView(1);
      };
    case "ArrowLeft":
      return () => (simulating && model.following ? tools.back() : model.stepView(-1));
    case "x":
    case "X":
      return simulating ? () => tools.fireChosen() : null;
    case "r":
    case "R":
      return simulating ? () => tools.reset() : null;
    case "e":
    case "E":
      return () => page.setShowEnabled(!page.showEnabled);
    case "l":
    case "L":
      return () => model.mode !== "REPLAY" && !model.following && model.backToLive();
    case "f":
    case "F":
      return () => view.camera.fit();
    case "+":
    case "=":
      return () => view.camera.zoom(1.25);
    case "-":
      return () => view.camera.zoom(0.8);
    case "p":
    case "P":
      return () => page.panels.toggle("left");
    case "d":
    case "D":
      return () => page.panels.toggle("right");
    case "t":
    case "T":
      return () => page.panels.toggle("bottom");
    case "w":
    case "W":
      return () => {
        page.panels.open("right");
        page.panels.widen();
      };
    case "/":
      return () => {
        page.panels.open("left");
        $("list-search").focus();
        $("list-search").select();
      };
    case "1":
    case "2":
    case "3":
    case "4":
      return () => page.showTab(TABS[Number(event.key) - 1]);
    case "o":
    case "O":
      return () => page.openScreen(true);
    case "Escape":
      return () => page.choose(null);
    default:
      return null;
  }
}
