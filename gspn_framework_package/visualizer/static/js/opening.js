// The input screen (thesis Figure 5.3): open a file from the served folder, or upload one.

import { h, $, attempt } from "./dom.js";
import { get, post } from "./api.js";
import { mayEdit, newPlan } from "./edit/new_plan.js";
import { HISTORY } from "./fleet_history.js";

const KINDS = { net: "net", plan: "plan", log: "recorded run" };

async function encoded(file) {
  const bytes = new Uint8Array(await file.arrayBuffer());
  let text = "";
  for (let i = 0; i < bytes.length; i += 0x8000)
    text += String.fromCharCode(...bytes.subarray(i, i + 0x8000));
  return { name: file.name, content: btoa(text) };
}

/** Shows the screen; resolves to {id, edit}: the key of the session that was opened, and whether to edit it. */
export async function openingScreen(hello) {
  const mayAct = hello.role !== "viewer";
  const fresh = (await attempt(() => get("hello"))) || hello;
  const screen = $("opening");
  return new Promise((resolve) => {
    const wrong = h("p.wrong", { id: "opening-wrong", role: "alert", hidden: true });
    // the reason why a file cannot be opened stays on the screen until another file is tried
    const tried = async (action) => {
      wrong.hidden = true;
      try {
        await action();
      } catch (error) {
        wrong.textContent = error.message;
        wrong.hidden = false;
        wrong.scrollIntoView({ block: "nearest" });
      }
    };
    const open = (path) =>
      tried(async () =>
        resolve({ id: mayAct ? (await post("open", { path })).id : `file-${path}` }),
      );
    const upload = (files) =>
      tried(async () => {
        if (!files.length) return;
        const body = { files: await Promise.all([...files].map(encoded)) };
        resolve({ id: (await post("upload", body)).id });
      });
    const chooser = h("input", {
      type: "file",
      multiple: true,
      class: "unseen",
      tabindex: "-1",
      id: "chooser",
      "aria-label": "Your own files",
      onchange: async (event) => {
        await upload(event.target.files);
        event.target.value = ""; // so that choosing the same file again has an effect
      },
    });
    const drop = h(
      "div.drop",
      h("p", "Drop a net here, or an input file together with its net."),
      h("button", { text: "Choose files …", onclick: () => chooser.click() }),
      chooser,
      h("p.muted", "PIPE XML, PNML, PNPRO, TINA .net; input files of plans as JSON."),
      h("p.muted", "Uploads are shown, simulated and analysed, but never executed."),
    );
    drop.ondragover = (event) => {
      event.preventDefault();
      drop.classList.add("over");
    };
    drop.ondragleave = () => drop.classList.remove("over");
    drop.ondrop = (event) => {
      event.preventDefault();
      drop.classList.remove("over");
      upload(event.dataTransfer.files);
    };
    const isCut = (file) => (fresh.cut || []).some(({ log }) => log === file.path);
    const rows = (kind) =>
      fresh.files
        .filter((file) => file.kind === kind)
        .map((file) =>
          h(
            "li",
            h(
              "button",
              { onclick: () => open(file.path) },
              h("span.path", file.path),
              h("span.badge", isCut(file) ? "cut off" : KINDS[kind]),
            ),
          ),
        );
    const all = [...rows("plan"), ...rows("net"), ...rows("log")];
    screen.replaceChildren(
      h(
        "div",
        h("h2", "Open a net or a plan"),
        h(
          "p.muted",
          "Simulate and analyse a net, execute a plan from this folder, or replay a recorded run.",
        ),
        h(
          "div.columns",
          h(
            "div.card",
            h("h3", "In this folder"),
            fresh.can_open
              ? all.length
                ? h("ul.files", all)
                : h("p.muted", "There is no net, plan or recorded run in this folder.")
              : h("p.muted", "This server serves no folder."),
            fresh.history &&
              h(
                "p",
                h("button", {
                  id: "open-history",
                  text: "History of the fleet",
                  onclick: () => resolve({ id: HISTORY }),
                }),
              ),
            mayEdit(fresh) &&
              h(
                "p",
                h("button", {
                  id: "ed-new",
                  text: "New plan …",
                  onclick: () =>
                    attempt(async () => {
                      const id = await newPlan(fresh);
                      if (id) resolve({ id, edit: true });
                    }),
                }),
              ),
          ),
          mayAct && h("div.card", h("h3", "Your own"), drop),
        ),
        wrong,
      ),
    );
    screen.hidden = false;
    screen.querySelector("button")?.focus();
  });
}

export function hideOpening() {
  $("opening").hidden = true;
}
