// The panel of the plan as a whole: a form for every key of a plan file except its net and policy.

import { PlanForm } from "./property_panel.js";
import { schemaField, wordOf } from "./schema_form.js";

const SECTIONS = [
  [
    "General",
    [
      "plan",
      "description",
      "synchronisation",
      "transport",
      "environment",
      "seed",
      "strict",
      "until",
    ],
  ],
  ["Robots", ["robots", "spawn", "on_lost", "on_evict"]],
  ["Places and actions", ["actions", "resource_places", "on_failure", "timeout", "cancel_grace"]],
  ["Parameters", ["parameters"]],
  ["Events and tasks", ["events", "tasks"]],
  ["Routing", ["routing"]],
  [
    "Durations, outcomes, failures, rates",
    ["durations", "outcomes", "failures", "own_times", "rates", "chance"],
  ],
  ["Agreement", ["agreement"]],
];
const ELSEWHERE = ["net", "policy"]; // edited in the drawing and in the policy panel

export class PlanPanel extends PlanForm {
  constructor(mode) {
    super(mode, "plan", "Plan");
  }

  content() {
    const known = new Set([...ELSEWHERE, ...SECTIONS.flatMap(([, keys]) => keys)]);
    const others = Object.keys(this.schema.properties).filter((key) => !known.has(key));
    return [...SECTIONS, ["More", others]].map(([title, keys]) => {
      const present = keys.filter((key) => key in this.schema.properties);
      return (
        present.length > 0 &&
        this.section(`plan ${title}`, title, title === "General", () =>
          present.map((key) => schemaField(this, this.part(key), this.plan(key), wordOf(key))),
        )
      );
    });
  }
}
