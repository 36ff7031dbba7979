// Creates a new plan in the served folder.

import { h, ask, cancelOr } from "../dom.js";
import { post } from "../api.js";

/** Whether the viewer may edit the files of the folder. */
export const mayEdit = (hello) =>
  Boolean(hello?.edits && hello.role !== "viewer" && hello.can_open);

/** Ask for a name and a template, and create the plan. Returns its key, or null. */
export async function newPlan(hello) {
  const name = h("input", {
    type: "text",
    id: "ed-new-name",
    autocomplete: "off",
    autofocus: true,
  });
  const template = h(
    "select",
    { id: "ed-new-template" },
    h("option", { value: "", text: "empty" }),
    (hello.templates || []).map((text) => h("option", { value: text, text })),
  );
  let id = null;
  await ask(
    "New plan",
    h(
      "div.form",
      h("label", { for: "ed-new-name", text: "Name" }),
      name,
      h("label", { for: "ed-new-template", text: "Start from" }),
      template,
    ),
    cancelOr("Make it", "make"),
    async () => {
      const body = { name: name.value.trim(), template: template.value };
      ({ id } = await post("edit/new", body));
    },
  );
  return id;
}
