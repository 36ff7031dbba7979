// The pictures on the buttons of the editor, drawn on 16 × 16 px: the id of a button of the tool bar, or what a button
// of the table of the policy does -> the lines of its picture.

import { s } from "../dom.js";

const ICONS = {
  "ed-save": "M2.5 2.5h8.5l2.5 2.5v8.5h-11zM5 2.5v4h5v-4M5 13.5v-4h6v4",
  "ed-save-as": "M2.5 2.5h7l2.5 2.5M2.5 2.5v11h5M5 2.5v4h4v-4M9 13.5l.5-2.5 4-4 2 2-4 4z",
  "ed-export": "M8 10V2.5M5 5.5l3-3 3 3M2.5 9.5v4h11v-4",
  "ed-deploy":
    "M8 1.8c2.6 1.6 3.4 4.4 2.8 8.2H5.2C4.6 6.2 5.4 3.4 8 1.8zM5 8l-2.5 3 2.7-.5M11 8l2.5 3-2.7-.5M8 12v2.5",
  "ed-undo": "M5.5 3L2.5 6l3 3M2.5 6h7a4 4 0 0 1 0 8H6",
  "ed-redo": "M10.5 3l3 3-3 3M13.5 6h-7a4 4 0 0 0 0 8H10",
  "ed-add-place": "M13.5 8a5.5 5.5 0 1 1-11 0a5.5 5.5 0 1 1 11 0",
  "ed-add-timed": "M5.5 2.5h5v11h-5z",
  "ed-add-immediate": "M8 2.5v11M7.2 2.5v11M8.8 2.5v11",
  "ed-arc": "M2.5 13.5L13 3M7.5 2.8H13.2V8.5",
  "ed-delete": "M3 4.5h10M6.5 4.5v-2h3v2M4.2 4.5l.8 9h6l.8-9M6.8 7v4M9.2 7v4",
  "ed-more": "M8 3v10M3 8h10",
  "ed-less": "M3 8h10",
  "ed-inhibit": "M2 8h7M14 8a2.5 2.5 0 1 1-5 0a2.5 2.5 0 1 1 5 0",
  "ed-timed": "M2.5 3.5h4v9h-4zM12 3.5v9M11.2 3.5v9",
  "ed-verdict": "M11.5 7a4.5 4.5 0 1 1-9 0a4.5 4.5 0 1 1 9 0M10.3 10.3l3.2 3.2",
  "ed-here-open": "M5.6 6a2.4 2.4 0 1 1 3.6 2.1c-.8.5-1.2.9-1.2 1.9M8 12.8v.1",
  "row-duplicate": "M6 6h7.5v7.5H6zM10 6V2.5H2.5V10H6",
  "ed-diff": "M5 2.5v6M2 5.5h6M8.5 12.5h5.5M12.5 2.5l-9 11",
};

/** The picture of a button, or nothing for a button that has none. */
export const iconOf = (id) =>
  ICONS[id] &&
  s("svg", { viewBox: "0 0 16 16", "aria-hidden": "true" }, s("path", { d: ICONS[id] }));
