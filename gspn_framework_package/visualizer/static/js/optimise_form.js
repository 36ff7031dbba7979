// The form of the Optimise tab: the aim of the policy to compute. Errors are shown at their fields.

import { h, labelled, markWrong, menu, natural, options, question, textField } from "./dom.js";

const AIMS = [
  ["long_run", "reward in the long run"],
  ["discounted", "discounted reward"],
  ["reach", "probability to reach …"],
  ["time_to", "mean time until …"],
  ["cost_to", "mean cost until …"],
];

/** The parts of the form that an aim uses. */
const USES = {
  long_run: ["direction", "rewards", "at_least"],
  discounted: ["direction", "rewards", "discount"],
  reach: ["direction", "goal"],
  time_to: ["goal"],
  cost_to: ["goal", "rewards"],
};

const id = (name) => `op-${name.replaceAll(".", "-")}`;

const number = (attributes) => textField({ type: "number", step: "any", ...attributes });
const amount = () => number({ value: "" });

export class OptimiseForm {
  constructor(model) {
    this.model = model;
    this.controls = new Map(); // name of a field -> its control
    this.parts = {}; // name of a part -> the elements shown or hidden together
    this.lists = {};
    this.element = h("div", this.aim(), this.constraints(), this.settings());
    this.element.addEventListener("input", ({ target }) => this.forget(target));
    this.addEntry("rewards");
    this.showParts();
  }

  // -- building ------------------------------------------------------------------------------------

  /** A label and its control, as two cells of a form. */
  field(name, label, control) {
    control.id = id(name);
    this.controls.set(name, control);
    this.parts[name] = labelled(label, control);
    return this.parts[name];
  }

  aim() {
    const direction = [
      ["most", "as high as possible"],
      ["least", "as low as possible"],
    ];
    return question(
      "Aim",
      true,
      h(
        "div.form",
        this.field("aim", "Aim", menu(AIMS, { onchange: () => this.showParts() })),
        this.field("direction", "Make it", menu(direction)),
        this.field("goal", "Condition", textField({ placeholder: "p1 >= 1 and p2 == 0" })),
        this.field("discount", "Discount (per second)", number({ min: 0, value: 0.01 })),
      ),
      this.list("rewards", ["Rewards", "", "Add a reward"], {
        name: ["Rewarded", () => this.nodes()],
        value: ["Reward", () => number({ value: 1 })],
      }),
    );
  }

  constraints() {
    return question(
      "Constraints",
      false,
      this.list(
        "never",
        ["Never", "Conditions that must never hold, even when robots are lost.", "Add a condition"],
        { entry: ["Condition", textField] },
      ),
      this.list(
        "at_least",
        [
          "At least",
          "Mean tokens of a place, or firings of a transition per second.",
          "Add a lower bound",
        ],
        { name: ["Bounded", () => this.nodes()], bound: ["At least", amount] },
      ),
      this.waiting(),
      this.list(
        "uncertain",
        [
          "Uncertain rates",
          "Lowest and highest rate (1/s) of an exponential transition: the policy is the best for the worst rate.",
          "Add a rate",
        ],
        {
          name: ["Uncertain", () => this.nodes(true)],
          low: ["Lowest", amount],
          high: ["Highest", amount],
        },
      ),
    );
  }

  /** The places where a robot chooses, and so may be allowed to wait. */
  waiting() {
    const { places, transitions, arcs } = this.model.scene;
    const decides = new Set(
      arcs
        .filter(([, t, forth, , inhibitor]) => forth && !inhibitor && !transitions[t].timed)
        .map(([p]) => p),
    );
    this.mayWait = places
      .filter((place, p) => place.kind === "action" && decides.has(p))
      .map(({ name }) => name)
      .sort(natural)
      .map((name) => h("input", { type: "checkbox", value: name }));
    const group = h(
      "fieldset",
      { id: id("may_wait"), tabindex: "-1" },
      h("legend", "May wait"),
      h(
        "p.muted",
        this.mayWait.length
          ? "Places where a robot may stay although it could leave."
          : "No robot chooses in any place of this plan.",
      ),
      this.mayWait.length > 3 &&
        h(
          "div.buttons",
          h("button", { type: "button", text: "All", onclick: () => this.waitIn(true) }),
          h("button", { type: "button", text: "None", onclick: () => this.waitIn(false) }),
        ),
      h(
        "div.choices",
        this.mayWait.map((box) => h("label", { title: box.value }, box, ` ${box.value}`)),
      ),
    );
    this.controls.set("may_wait", group);
    return group;
  }

  waitIn(all) {
    for (const box of this.mayWait) box.checked = all;
  }

  settings() {
    const time = [
      ["run", "as the plan runs"],
      ["net", "as in its net alone"],
    ];
    const rates = [
      ["fitted", "as learned, where the plan has them"],
      ["nominal", "those of the net"],
    ];
    const teams = [
      ["plan", "the plan's, and the smaller ones after losses"],
      ["own", "the plan's only"],
      ["all", "of every size up to the plan's"],
    ];
    return question(
      "Settings",
      false,
      h(
        "div.form",
        this.field("timing", "Time", menu(time)),
        this.field("fitted", "Rates", menu(rates)),
        this.field("teams", "Teams", menu(teams)),
        this.field("simulated", "Compare by simulation (s)", number({ min: 0, max: 60, value: 5 })),
        this.field("limit", "Max. states", number({ min: 1, max: 2000000, value: 500000 })),
        this.field("seconds", "Max. seconds", number({ min: 1, max: 600, value: 120 })),
      ),
    );
  }

  /** A list to which entries can be added. `fields`: those of an entry, key -> [label, maker of the control]; an entry
   * with the only key "entry" is a value, others are objects. */
  list(name, [title, about, adds], fields) {
    const entries = h("div.entries");
    const add = h("button", {
      type: "button",
      id: id(name),
      text: adds,
      onclick: () => this.addEntry(name),
    });
    this.controls.set(name, add);
    const list = {
      entries,
      fields,
      items: [],
      legend: h("legend", title),
      about: h("p.muted", about),
    };
    this.lists[name] = list;
    const group = h("fieldset", list.legend, list.about, entries, add);
    this.parts[name] = [group];
    return group;
  }

  /** Add an empty entry to a list; its first control gets the focus. */
  addEntry(name) {
    const list = this.lists[name];
    const controls = new Map(Object.entries(list.fields).map(([key, [, make]]) => [key, make({})]));
    const item = { controls };
    const remove = () => {
      const at = list.items.indexOf(item);
      list.items.splice(at, 1);
      item.element.remove();
      this.nameControls(list);
      const next = list.items[Math.min(at, list.items.length - 1)];
      (next ? next.element.querySelector("button") : this.controls.get(name)).focus();
    };
    const removes = h("button.icon", { type: "button", text: "×", onclick: remove });
    item.element = h("div.entry", [...controls.values()], removes);
    list.items.push(item);
    list.entries.append(item.element);
    this.nameControls(list);
    controls.values().next().value.focus();
  }

  /** Name the controls of a list's entries by their position, for screen readers. */
  nameControls({ items, fields }) {
    items.forEach(({ controls, element }, i) => {
      for (const [key, control] of controls)
        control.setAttribute("aria-label", `${fields[key][0]} ${i + 1}`);
      element.querySelector("button").setAttribute("aria-label", `Remove entry ${i + 1}`);
    });
  }

  /** A menu of all places and transitions, or of the exponential transitions. */
  nodes(timed = false) {
    const { places, transitions } = this.model.scene;
    const group = (title, nodes) => {
      const names = nodes.map((node) => node.name).sort(natural);
      return h("optgroup", { label: title }, options(names));
    };
    return h(
      "select",
      options([["", "choose …"]]),
      !timed && group("Places", places),
      group("Transitions", timed ? transitions.filter((t) => t.timed) : transitions),
    );
  }

  /** Show the parts that the chosen aim uses. */
  showParts() {
    const { value } = this.controls.get("aim");
    const costs = value === "cost_to";
    for (const name of ["direction", "goal", "discount", "rewards", "at_least"])
      for (const element of this.parts[name]) element.hidden = !USES[value].includes(name);
    const { rewards } = this.lists;
    rewards.legend.textContent = costs ? "Costs" : "Rewards";
    rewards.about.textContent = `Per token and second in a place, or per firing of a transition.${
      costs ? "" : " Costs are negative."
    }`;
    this.controls.get("rewards").textContent = costs ? "Add a cost" : "Add a reward";
  }

  // -- reading, and errors --------------------------------------------------------------------

  value(name) {
    return this.controls.get(name).value;
  }

  /** The fields of the request: {optimise, limit, seconds}. */
  read() {
    const aim = this.value("aim");
    const valueOf = ({ controls }) =>
      controls.get("entry")?.value ??
      Object.fromEntries([...controls].map(([key, control]) => [key, control.value]));
    const entries = (name) =>
      USES[aim].includes(name) || ["never", "uncertain"].includes(name)
        ? this.lists[name].items.map(valueOf)
        : [];
    return {
      optimise: {
        aim,
        maximise: this.value("direction") === "most",
        goal: this.value("goal"),
        discount: this.value("discount"),
        rewards: entries("rewards"),
        never: entries("never"),
        at_least: entries("at_least"),
        may_wait: this.mayWait.filter((box) => box.checked).map((box) => box.value),
        uncertain: entries("uncertain"),
        timing: this.value("timing"),
        teams: this.value("teams"),
        fitted: this.value("fitted") === "fitted",
        simulated: this.value("simulated"),
      },
      limit: Math.round(Number(this.value("limit"))),
      seconds: Number(this.value("seconds")),
    };
  }

  /** The control of a field, such as rewards.0.value. */
  control(name) {
    const [list, at, key] = name.split(".");
    const item = this.lists[list]?.items[Number(at)];
    if (item) return item.controls.get(key || "entry") || item.controls.values().next().value;
    return this.controls.get(list) || this.controls.get("aim");
  }

  /** Show errors at their fields: {name: text}. The topmost field gets the focus. */
  tell(fields) {
    this.clear();
    for (const [name, text] of Object.entries(fields)) {
      const control = this.control(name);
      const error = h("p.wrong", { id: `${id(name)}-wrong`, text });
      const entry = control.closest(".entry");
      if (entry) entry.after(error);
      else if (control.tagName === "FIELDSET") control.append(error);
      else control.after(error);
      error.control = control;
      markWrong(control, error);
      control.closest("details").open = true;
    }
    this.element.querySelector("[aria-invalid='true']")?.focus();
  }

  clear() {
    for (const error of this.element.querySelectorAll(".wrong")) this.remove(error);
  }

  /** Clear the error of a field that is being changed. */
  forget(control) {
    for (const error of this.element.querySelectorAll(".wrong"))
      if (error.control === control || error.control.contains(control)) this.remove(error);
  }

  remove(error) {
    markWrong(error.control, null);
    error.remove();
  }
}
