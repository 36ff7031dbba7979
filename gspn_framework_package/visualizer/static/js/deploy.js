// Deploying: the changes that another plan makes in a running team, the confirmation, the votes and the outcome.

import { h, ask, cancelOr, labelled, menu, plural, pause } from "./dom.js";
import { get, post } from "./api.js";
import { changeList } from "./edit/diff_view.js";

const FINDINGS = 20; // findings of the check that are listed
const POLL = 250; // ms between two requests for the votes
const DROPPED = "\u0000"; // not a valid name; stands for "drop the tokens of the resource place"

/** The form that maps names missing from the new plan to its names; `read()` returns the mapping. */
function mappingForm({ gone, names }) {
  if (!gone.length) return { element: null, read: () => ({}) };
  const fields = gone.map(({ name, kind }, index) => {
    const choices = [
      ["", "is gone"],
      ...(kind === "resource place" ? [[DROPPED, "drop its tokens"]] : []),
      ...(names[kind] || []).map((to) => [to, `is now ${to}`]),
    ];
    const select = menu(choices, { id: `dp-map-${index}`, "data-name": name });
    return { name, select, row: labelled(`${kind} ${name}`, select) };
  });
  const read = () =>
    Object.fromEntries(
      fields
        .filter(({ select }) => select.value)
        .map(({ name, select }) => [name, select.value === DROPPED ? "" : select.value]),
    );
  const element = h(
    "section",
    { "aria-label": "Names that are missing" },
    h("p", "The new plan does not have these names. What replaces them?"),
    h(
      "div.form",
      { id: "dp-map" },
      fields.map(({ row }) => row),
    ),
  );
  return { element, read };
}

/** Findings of the check for the new plan, errors first. */
function verdictOf({ verdict, refused, findings }) {
  const words = { error: "Error", warning: "Warning" };
  return h(
    "section",
    { "aria-label": "Results of the check", id: "dp-verdict" },
    h("p", { class: refused ? "wrong" : "", text: `The check: ${verdict}.` }),
    findings.length > 0 &&
      h(
        "ul",
        { class: `ed-level ${refused ? "error" : "warning"}` },
        findings.slice(0, FINDINGS).map(({ level, text }) => h("li", `${words[level]}: ${text}`)),
        findings.length > FINDINGS && h("li", `and ${findings.length - FINDINGS} more`),
      ),
  );
}

/** The votes in words. */
function voteList(votes) {
  const said = { null: "is checking the plan …", "": "can follow it" };
  return h(
    "ul.ed-changes",
    { id: "dp-votes" },
    Object.entries(votes).map(([who, why]) =>
      h("li", {
        class: why === "" ? "diff-added" : why === null ? "" : "diff-removed",
        text: `${who}: ${said[why] ?? why}`,
      }),
    ),
  );
}

/** Show the progress of the deployment until it ends; resolves to whether the run follows the plan. */
async function follow(id, plan) {
  const state = h("p", {
    id: "dp-state",
    role: "status",
    text: "The members are checking the plan …",
  });
  const votes = h("div", voteList({}));
  const closed = { now: false };
  const dialog = ask(`Deploying “${plan}”`, [state, votes], [["Close", "", "primary"]]);
  dialog.then(() => {
    closed.now = true;
  });
  let found = { state: "looking" };
  while (found.state === "looking" && !closed.now) {
    try {
      found = await get("deploy", { id });
      votes.replaceChildren(voteList(found.votes || {}));
    } catch (error) {
      found = { state: "refused", says: error.message };
    }
    if (found.state === "looking") await pause(POLL);
  }
  const done = found.state === "done";
  state.className = done ? "" : "wrong";
  state.textContent = done
    ? `Deployed: ${found.says}.`
    : `Not deployed; the run continues as before: ${found.says}.`;
  await dialog;
  return done;
}

/** Deploy a plan to the run of the session `id`. `what`: {path} or {job}; `run`: the expected name of the run. */
async function deployTo(id, what, run) {
  const look = await post("deploy/look", what, { id });
  const { element, read } = mappingForm(look);
  const begin = () => post("deploy", { ...what, map: read(), run }, { id });
  const answer = await ask(
    `Deploy “${look.plan}” to the team?`,
    [
      h(
        "p",
        `The run “${run || look.present}” follows “${look.present}” now. ` +
          "Its robots check the new plan; if all of them can follow it, they switch to it without stopping.",
      ),
      verdictOf(look),
      h("h3", plural(look.changes.length, "change")),
      changeList(look.changes),
      !look.refused && element,
    ],
    look.refused ? [["Close", "", "primary"]] : cancelOr("Deploy to the team", "deploy"),
    begin,
  );
  return answer === "deploy" && follow(id, look.plan);
}

/** Deploy a plan to a run that this server shows: that of the session `id`, if there is one; otherwise ask which. */
export async function deployToARun(what, id) {
  const { runs } = await get("deploy/targets");
  if (!runs.length)
    throw new Error("there is no run that could take the plan: start one, then deploy to it");
  let target = runs.find((each) => each.id === id) || runs[0];
  if (runs.length > 1 && target.id !== id) {
    const chosen = await ask("Deploy to which run?", h("p", "There are several runs."), [
      ["Cancel", ""],
      ...runs.map((each) => [each.run || each.title, each.id]),
    ]);
    target = runs.find((each) => each.id === chosen);
  }
  return Boolean(target) && deployTo(target.id, what, target.run);
}
