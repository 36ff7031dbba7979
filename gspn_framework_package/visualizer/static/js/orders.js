// The operator's orders to a running team. Each order names the run shown; its result is shown and stored. The server
// lists the possible orders, with their fields, words and dialogs (team/orders.py explains the forms).

import { h, ask, announce, clock, labelled, toast } from "./dom.js";
import { post } from "./api.js";
import { reportOf } from "./phases.js";

export const ONLY_LOOK = "the viewer's token is read-only";
const KEPT = 6;

/** The JSON object in a text; throws an error that says what is wrong. */
function jsonObject(text) {
  let value;
  try {
    value = JSON.parse(text.trim() || "{}");
  } catch (error) {
    throw new Error(`the data is not JSON: ${error.message}`, { cause: error });
  }
  if (value === null || typeof value !== "object" || Array.isArray(value))
    throw new Error('the data must be a JSON object, such as {"pose": [1, 2]}');
  return value;
}

/** The whole number in a text; the text itself if it is not one, for the server to refuse. */
const wholeNumber = (text) => (/^-?\d{1,15}$/.test(text) ? Number(text) : text);

/** The values of fields that were given in elements: name -> value. */
function valuesOf(inputs) {
  const read = { object: jsonObject, number: (text) => wholeNumber(text.trim()) };
  return Object.fromEntries(
    inputs.map(({ field, element }) => [
      field.name,
      (read[field.kind] || ((text) => text.trim()))(element.value),
    ]),
  );
}

/** Fires "given" when an order has been answered. */
export class Orders extends EventTarget {
  /** `page` knows the model and the role. */
  constructor(page) {
    super();
    this.page = page;
    this.table = page.hello.orders; // command -> its form
    this.given = []; // the latest first: {time, says, answer, good}
  }

  get model() {
    return this.page.model;
  }

  /** Whether this run accepts orders of this kind. */
  offers(command) {
    const { model } = this;
    return (
      model.mode === "LIVE" &&
      !model.head.status.ended &&
      (model.info.commands || []).includes(command)
    );
  }

  /** Why no order can be given now; "" if one can. */
  get refusal() {
    if (!this.page.mayAct) return ONLY_LOOK;
    if (this.model.stale) return "no contact with the server";
    if (this.model.unheard) return "no robot of the team has been heard from yet";
    return "";
  }

  /** The orders that this run accepts and whose form belongs there. */
  at(where) {
    return Object.keys(this.table).filter(
      (command) => this.table[command].where === where && this.offers(command),
    );
  }

  /** The buttons of the orders whose form belongs there, with these fields. */
  buttons(where, fields) {
    return this.at(where).flatMap((command) => [
      this.button(command, Object.values(fields).join(" "), () => this.order(command, fields)),
      ...this.flagged(command, fields),
    ]);
  }

  /** The buttons that give an order with one of its flags. */
  flagged(command, fields) {
    const flags = this.table[command].fields.filter(({ kind, label }) => kind === "flag" && label);
    return flags.map(({ name, label, help }) => {
      const about = `${Object.values(fields).join(" ")} ${name}`;
      const says = `${label} ${fields.robot || "all actions"}`;
      const give = () => this.give(command, { ...fields, [name]: true }, says);
      return this.button(command, about, give, { label, about: help });
    });
  }

  /** A button that calls `act`, or shows why it is disabled; null if the run does not accept `command`. */
  button(command, about, act, form = this.table[command]) {
    if (!this.offers(command)) return null;
    const refusal =
      this.refusal || (this.model.following ? "" : "the view is paused: return to live first");
    return h("button", {
      text: form.label,
      class: form.style || "",
      "data-order": command,
      "data-focus": `${command} ${about}`,
      disabled: Boolean(refusal),
      title: refusal || form.about,
      onclick: act,
    });
  }

  /** Give an order; returns whether it was accepted. */
  async give(command, fields, says) {
    const { model } = this;
    const order = { time: new Date(), says, answer: "", good: false };
    try {
      const answer = await post(
        "do",
        { command, ...fields, run: model.head.status.run || "" },
        { id: model.session.id },
      );
      Object.assign(order, { answer: answer.message || "taken", good: true });
    } catch (error) {
      order.answer = error.message;
    }
    if (this.model !== model) return order.good;
    this.given = [order, ...this.given].slice(0, KEPT);
    this.listed = null;
    toast(`${says}: ${order.answer}`, order.good);
    announce(`${says}: ${order.answer}`);
    this.dispatchEvent(new CustomEvent("given"));
    return order.good;
  }

  /** The orders of this page and their results. */
  list() {
    if (!this.given.length) return null;
    const line = ({ time, says, answer, good }) =>
      h(
        good ? "li" : "li.refused",
        h("time", clock(time)),
        h("span", says, h("span.muted", ` — ${good ? "" : "refused: "}${answer}`)),
      );
    this.listed ||= h(
      "section",
      h("h3", "Orders from this page"),
      h("ol.orders", this.given.map(line)),
    );
    return this.listed;
  }

  // -- orders and their dialogs ----------------------------------------------------------------------

  get runName() {
    return this.model.head.status.run || this.model.scene.plan?.name || this.model.scene.name;
  }

  /** Give an order with these fields; if its form has a dialog, first ask for the other fields or for confirmation. */
  async order(command, fields = {}) {
    const { model } = this;
    const form = this.table[command];
    const inputs = form.title ? this.inputs(command, fields) : [];
    const text = (template) => this.words(template, fields);
    const give = () => {
      const whole = { ...fields, ...valuesOf(inputs) };
      return this.give(command, whole, this.words(form.says, whole));
    };
    if (!form.title) {
      await give();
      return;
    }
    await ask(
      text(form.title),
      [
        h("p", text(form.text)),
        inputs.map(({ field, element }) => h("div.form", labelled(field.label, element))),
      ],
      [
        ["Cancel", "", form.style.includes("primary") ? "" : "primary"],
        [text(form.confirm), command, form.style],
      ],
      async () => {
        if (this.model === model && !(await give()) && inputs.length)
          throw new Error(this.given[0].answer);
      },
    );
  }

  /** A template of a form, filled in with fields and what the page knows. */
  words(template, fields) {
    const { board, scene } = this.model;
    const robot = board.robots.get(fields.robot);
    const place = scene.places[robot?.place]?.name;
    const { word } = reportOf(robot?.phase);
    const team = [...board.robots.values()]
      .filter(({ phase }) => !reportOf(phase).gone)
      .map(({ name }) => name);
    const known = {
      run: this.runName,
      state: `${fields.robot}${place ? ` is in ${place}` : ""}${word ? `: it ${word}` : ""}.`,
      team: team.length > 12 ? `${team.length} robots` : team.join(", ") || "no robot is known",
      ...fields,
    };
    return template.replace(/\{(\w+)\}/g, (_, name) => known[name] ?? "");
  }

  /** The elements in which the fields are given that `fields` does not have: [{field, element}, ...]. */
  inputs(command, fields) {
    return this.table[command].fields
      .filter(({ name }) => !(name in fields))
      .map((field) => ({ field, element: this.input(field, fields) }));
  }

  input({ name, kind, label, placeholder }, { robot }) {
    const about = { id: `order-${name}`, "aria-label": label };
    if (kind === "place") {
      const { scene, board } = this.model;
      const present = scene.places[board.robots.get(robot)?.place]?.name;
      const places = scene.places.filter((place) => place.kind === "action");
      const option = (place) =>
        h("option", { value: place.name, text: place.name, selected: place.name === present });
      return h("select", about, places.map(option));
    }
    if (kind === "object") {
      const element = h("textarea", { ...about, rows: 5, spellcheck: "false" });
      element.value = "{}";
      return element;
    }
    return h("input", { ...about, type: "text", placeholder, maxlength: 200, autocomplete: "off" });
  }

  /** The names of the places and transitions with a breakpoint. */
  get breakpoints() {
    return this.model.info.breakpoints || [];
  }

  /** The button that sets or removes the breakpoint of a node; null if no robot can stop at it. */
  breakpoint(node) {
    const { breakpoints } = this;
    const has = breakpoints.includes(node.name);
    if (!node.breakable && !has) return null;
    const names = has
      ? breakpoints.filter((name) => name !== node.name)
      : [...breakpoints, node.name];
    const says = `${has ? "Remove" : "Set"} breakpoint`;
    return this.button(
      "breakpoints",
      node.name,
      () => this.give("breakpoints", { names }, `${says} at ${node.name}`),
      { label: says, about: "A robot that arrives here stops until it is resumed" },
    );
  }

  /** The rarer orders for one robot, each with its description. */
  async more(robot) {
    const fields = { robot: robot.name };
    const inputs = new Map(this.at("more").map((each) => [each, this.inputs(each, fields)]));
    const row = ([command, given]) =>
      h(
        "div.choice",
        h("p", this.table[command].about),
        h(
          "div.buttons",
          given.map(({ element }) => element),
          h("button", {
            text: this.table[command].label,
            class: this.table[command].style,
            value: command,
            onclick: (event) => event.target.closest("dialog").close(command),
          }),
        ),
      );
    const present = this.model.scene.places[robot.place]?.name || "no place";
    const text = `Run “${this.runName}”; ${robot.name} is in ${present}.`;
    const answer = await ask(
      `Orders for ${robot.name}`,
      [h("p.muted", text), [...inputs].map(row)],
      [["Cancel", ""]],
    );
    if (answer) await this.order(answer, { ...fields, ...valuesOf(inputs.get(answer)) });
  }

  /** The buttons for a task that waits or that a robot has: [id, data]. */
  ofTask(task) {
    return task?.[0] ? this.buttons("task", { id: task[0] }) : [];
  }

  /** The buttons on the card of a robot. */
  ofRobot(robot) {
    const is = reportOf(robot.phase);
    if (is.gone || is.at_rest) return [];
    const fields = { robot: robot.name };
    const rare = this.at("more");
    return [
      ...(is.failed ? this.buttons("failed", fields) : []),
      ...this.buttons(robot.paused ? "paused" : "running", fields),
      ...(robot.paused && this.offers("pause") ? this.flagged("pause", fields) : []),
      ...this.ofTask(robot.task),
      rare.length > 0 &&
        this.button(rare[0], robot.name, () => this.more(robot), {
          label: "More …",
          about: rare.map((command) => this.table[command].label).join(", "),
        }),
    ].filter(Boolean);
  }
}
