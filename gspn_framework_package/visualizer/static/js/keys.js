// The keyboard shortcuts of the page, and their table.

import { $, h, ask, attempt, dialogOpen } from "./dom.js";
import { EDIT_KEYS } from "./edit/edit_keys.js";

/** The tabs of the details, in their order. */
export const TABS = ["inspector", "robots", "analysis", "optimise", "story"];

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
  ["1  2  3  4  5", "inspector, robots, analysis, optimise, story"],
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

/** A table without heads. */
const plain = (rows) => {
  const cells = (row) => row.map((cell) => h("td", cell));
  return h(
    "table",
    h(
      "tbody",
      rows.map((row) => h("tr", cells(row))),
    ),
  );
};

/** Show the keys of the page, or those of its editor. */
export function showHelp(editing = false) {
  return ask(
    "Keys and symbols",
    [
      plain((editing ? EDIT_KEYS : TABLE).map(([key, says]) => [h("kbd", key), says])),
      h("h3", "In the net"),
      plain(SYMBOLS),
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
  const { model, tools, view, panels } = page;
  if (event.key === "?") return () => showHelp(Boolean(page.editor.mode));
  if (!model || !model.board) return null;
  const simulating = model.mode === "SIMULATE";
  const present = simulating && model.following;
  const steps = event.shiftKey ? tools.steps : 1;
  const zoomIn = () => view.camera.zoom(1.25);
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  const tab = TABS[Number(key) - 1];
  if (tab) return () => page.showTab(tab);
  const actions = {
    " ": () => page.togglePause(),
    ArrowRight: async () => {
      if (present) await tools.step(steps);
      else for (let i = 0; i < steps; i++) await model.stepView(1);
    },
    ArrowLeft: () => (present ? tools.back() : model.stepView(-1)),
    x: simulating && (() => tools.fireChosen()),
    r: simulating && (() => tools.reset()),
    e: () => page.setShowEnabled(!page.showEnabled),
    l: () => model.mode !== "REPLAY" && !model.following && model.backToLive(),
    f: () => view.camera.fit(),
    "+": zoomIn,
    "=": zoomIn,
    "-": () => view.camera.zoom(0.8),
    p: () => panels.toggle("left"),
    d: () => panels.toggle("right"),
    t: () => panels.toggle("bottom"),
    w: () => {
      panels.open("right");
      panels.widen();
    },
    "/": () => {
      panels.open("left");
      $("list-search").focus();
      $("list-search").select();
    },
    o: () => page.openScreen(true),
    Escape: () => page.choose(null),
  };
  return actions[key] || null;
}
