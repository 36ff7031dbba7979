// Creates a new plan in the served folder.

import { h, ask, cancelOr, labelled, menu, textField } from "../dom.js";
import { post } from "../api.js";

/** Whether the viewer may edit the files of the folder. */
export const mayEdit = (hello) =>
  Boolean(hello?.edits && hello.role !== "viewer" && hello.can_open);

/** Ask for a name and a template, and create the plan. Returns its key, or null. */
export async function newPlan(hello) {
  const name = textField({ id: "ed-new-name", autofocus: true });
  const choices = [["", "empty"], ...(hello.templates || [])];
  const template = menu(choices, { id: "ed-new-template" });
  let id = null;
  await ask(
    "New plan",
    h("div.form", labelled("Name", name), labelled("Start from", template)),
    cancelOr("Make it", "make"),
    async () => {
      const body = { name: name.value.trim(), template: template.value };
      ({ id } = await post("edit/new", body));
    },
  );
  return id;
}
