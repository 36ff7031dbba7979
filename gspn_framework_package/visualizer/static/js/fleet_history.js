// A fleet's history: what months of logs show about robots, places and days, with a link to the replay of each moment.

import { $, h, s, attempt, columns, menu, number, plural, table } from "./dom.js";
import { get } from "./api.js";
import { curvePlot, CURVES } from "./plot.js";

/** The address of this screen; "history-" and a key is that of the replay of a run. */
export const HISTORY = "history";

const GROUPS = ["robot", "place", "day"];
const KINDS = { failure: "failure", alarm: "alarm", intervention: "order", wait: "long wait" };
const COLUMNS = [
  ["Visits", (row) => number(row.visits)],
  ["Acting (h)", (row) => hours(row.acting_s)],
  ["Waiting (h)", (row) => hours(row.waiting_s)],
  ["Paused (h)", (row) => hours(row.paused_s)],
  ["Failed (h)", (row) => hours(row.failed_s)],
  ["Failures", (row) => number(row.failures)],
  ["Alarms", (row) => number(row.alarms)],
  ["Orders", (row) => number(row.interventions)],
];

const asked = { by: "robot", since: "", until: "", robot: "", place: "" }; // kept while the user looks at replays
// numbers of the latest requests: answers to older ones are discarded
let latest = 0,
  latestMoments = 0;

const hours = (seconds) => (seconds / 3600).toFixed(2);
const nameOf = (value) => value || "(team)";

export function hideHistory() {
  $("fleet").hidden = true;
  latest += 1;
  latestMoments += 1;
}

/** Show the screen. */
export async function showHistory() {
  const screen = $("fleet");
  const answer = h("div", { id: "fleet-answer" });
  screen.replaceChildren(h("div", h("h2", "History of the fleet"), answer));
  screen.hidden = false;
  const names = await attempt(() => get("history/names"));
  if (!names || screen.hidden) return;
  answer.before(filters(names, () => ask(answer)));
  await ask(answer);
}

/** The form that narrows the report; `changed` is called when it has changed. */
function filters(names, changed) {
  const field = (key, label, control) => {
    control.id = `fleet-${key}`;
    control.value = asked[key];
    control.onchange = () => {
      asked[key] = control.value;
      changed();
    };
    return h("label", `${label} `, control);
  };
  const [first, last] = [names.days[0], names.days[names.days.length - 1]];
  const date = () => h("input", { type: "date", min: first, max: last });
  return h(
    "form.fleet-form",
    { onsubmit: (event) => event.preventDefault() },
    field("by", "A row for each", menu(GROUPS)),
    field("since", "From", date()),
    field("until", "to", date()),
    field("robot", "Robot", menu([["", "all"], ...names.robots])),
    field("place", "Place", menu([["", "all"], ...names.places])),
  );
}

/** Ask for the report and show it. */
async function ask(answer) {
  const mine = (latest += 1);
  answer.inert = true; // its rows answer an earlier request
  const [reported, daily] = await Promise.all([
    attempt(() => get("history/report", asked)),
    attempt(() => get("history/report", { ...asked, by: "day" })),
  ]);
  if (mine !== latest) return;
  answer.inert = false;
  if (!reported || !daily) return;
  answer.replaceChildren(...plots(daily.rows), report(reported), h("div", { id: "fleet-moments" }));
  await tellMoments({});
}

/** Curves over the days; none for fewer than two days. */
function plots(rows) {
  if (rows.length < 2) return [];
  const first = Date.parse(rows[0].day);
  const curve = (name, value) => ({
    name,
    points: rows.map((row) => [(Date.parse(row.day) - first) / 86_400_000, value(row)]),
  });
  const since = `days since ${rows[0].day}`;
  const parts = [
    [
      ["acting (h)", (row) => row.acting_s / 3600],
      ["waiting (h)", (row) => row.waiting_s / 3600],
      ["failed (h)", (row) => row.failed_s / 3600],
    ],
    [
      ["failures", (row) => row.failures],
      ["alarms", (row) => row.alarms],
      ["orders", (row) => row.interventions],
    ],
  ];
  return [
    h(
      "div.fleet-plots",
      parts.map((part) =>
        h(
          "figure",
          curvePlot(
            part.map(([name, value]) => curve(name, value)),
            since,
          ),
          h(
            "figcaption",
            part.map(([name], i) => legend(name, CURVES[i])),
          ),
        ),
      ),
    ),
  ];
}

function legend(name, colour) {
  const sign = s("svg.fleet-sign", { viewBox: "0 0 10 10", "aria-hidden": "true" });
  const dot = s("circle", { cx: 5, cy: 5, r: 4 });
  dot.style.fill = colour;
  sign.append(dot);
  return h("span", sign, name);
}

/** A share as a bar with its number. */
function share(value) {
  if (value === null) return "–";
  const bar = s("svg.fleet-bar", { viewBox: "0 0 60 10", "aria-hidden": "true" });
  const inside = s("rect", { x: 0, y: 1, height: 8, width: 60 * value });
  inside.style.fill = CURVES[0];
  bar.append(s("rect.frame", { x: 0, y: 1, height: 8, width: 60 }), inside);
  return [bar, `${(100 * value).toFixed(1)} %`];
}

/** The report; a click on a row shows the moments behind it. */
function report({ rows, left_out: leftOut }) {
  if (!rows.length) return h("p.muted", "The store contains nothing for this selection.");
  const group = asked.by;
  const cells = (row) => {
    const onclick = () => tellMoments(ofRow(row));
    const link = h("button.link", { text: nameOf(row[group]), title: "What happened", onclick });
    const values = [share(row.use), ...COLUMNS.map(([, reported]) => reported(row))];
    return [h("th", { scope: "row" }, link), ...values.map((value) => h("td", value))];
  };
  const heads = columns([group, "Use", ...COLUMNS.map(([head]) => head)]);
  const shown = table("table", heads, rows.map(cells));
  shown.id = "fleet-table";
  return h(
    "div.fleet-table",
    shown,
    leftOut > 0 && h("p.muted", `${plural(leftOut, "row")} not shown.`),
  );
}

/** The request for the moments of a row. */
function ofRow(row) {
  if (asked.by === "day") return { since: row.day, until: row.day };
  return { [asked.by]: row[asked.by] };
}

/** The failures, alarms, orders and longest waits, each with a link to its replay. */
async function tellMoments(narrower) {
  const mine = (latestMoments += 1);
  const reported = await attempt(() =>
    get("history/moments", { ...asked, ...narrower, by: "robot" }),
  );
  const list = $("fleet-moments");
  if (!reported || !list || mine !== latestMoments) return;
  const about = Object.values(narrower)[0];
  list.replaceChildren(
    h("h3", about ? `What happened: ${about}` : "What happened"),
    reported.moments.length
      ? h("ul.fleet-moments", reported.moments.map(momentOf))
      : h("p.muted", "No failures, alarms, orders or waits."),
  );
}

function momentOf(moment) {
  const where = [moment.robot, moment.place].filter(Boolean).join(", ");
  return h(
    "li",
    h("a", {
      href: `#${encodeURIComponent(moment.id)}&slot=${moment.slot}`,
      text: moment.happened.replace("T", " ").slice(0, 19),
      title: "Replay this moment",
    }),
    h("span.badge", KINDS[moment.kind]),
    h("span", ` ${nameOf(where)}: ${moment.detail}`),
  );
}
