// The operator's orders to a running team. Each order names the run shown; its result is shown and stored.

import { h, ask, announce, toast } from "./dom.js";
import { post } from "./api.js";
import { reportOf } from "./phases.js";

export const ONLY_LOOK = "the viewer's token is read-only";
const KEPT = 6;
const RARE = ["set_place", "leave", "evict"]; // behind "More ..."

/** The JSON object in a text; an error that says what is wrong with it. */
function jsonObject(text) {
  let value;
  try {
    value = JSON.parse(text.trim() || "{}");
  } catch (error) {
    throw new Error(`the data is not JSON: ${error.message}`, { cause: error });
  }
  if (value === null || typeof value !== "object" || Array.isArray(value))
    throw new Error('the data is a JSON object, such as {"pose": [1, 2]}');
  return value;
}

/** Fires "given" when an order has been answered. */
export class Orders extends EventTarget {
  /** `page` knows the model and the role. */
  constructor(page) {
    super();
    this.page = page;
    this.given = []; // the latest first: {time, says, answer, good}
  }

  get model() {
    return this.page.model;
  }

  /** Whether this run accepts such orders at all. */
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
    if (this.model.unheard) return "no robot of the team has been heard yet";
    return "";
  }

  /** A button that calls `act`, or shows why it is disabled; none if the run does not accept `command`. */
  button(label, command, act, { about = "", kind = "", title = "" } = {}) {
    if (!this.offers(command)) return null;
    const refusal =
      this.refusal || (this.model.following ? "" : "the view is paused: go back to live first");
    return h("button", {
      text: label,
      class: kind,
      "data-order": command,
      "data-focus": `${command} ${about}`,
      disabled: Boolean(refusal),
      title: refusal || title,
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
    this.listed =
      this.listed ||
      h(
        "section",
        {},
        h("h3", { text: "Orders from this page" }),
        h(
          "ol",
          { class: "orders" },
          this.given.map(({ time, says, answer, good }) =>
            h(
              "li",
              { class: good ? "" : "refused" },
              h("time", { text: time.toLocaleTimeString([], { hour12: false }) }),
              h(
                "span",
                {},
                says,
                h("span", { class: "muted", text: ` — ${good ? "" : "refused: "}${answer}` }),
              ),
            ),
          ),
        ),
      );
    return this.listed;
  }

  // -- orders with a confirmation --------------------------------------------------------------------

  get runName() {
    return this.model.head.status.run || this.model.scene.plan?.name || this.model.scene.name;
  }

  async stop() {
    const { model } = this;
    const robots = [...model.board.robots.values()]
      .filter(({ phase }) => !reportOf(phase).gone)
      .map(({ name }) => name);
    const known = robots.join(", ") || "no robot is known";
    const team = robots.length > 12 ? `${robots.length} robots` : known;
    const reason = h("input", {
      type: "text",
      id: "stop-reason",
      placeholder: "stopped on the page",
      maxlength: 200,
      autocomplete: "off",
    });
    const answer = await ask(
      `Stop the run “${this.runName}”?`,
      [
        h("p", {
          text: `The run ends for the whole team: ${team}. Running actions are cancelled. This cannot be undone.`,
        }),
        h(
          "div",
          { class: "form" },
          h("label", { for: "stop-reason", text: "Reason, for the log" }),
          reason,
        ),
      ],
      [
        ["Cancel", ""],
        ["Stop the run", "stop", "danger primary"],
      ],
    );
    if (answer !== "stop" || this.model !== model) return;
    const fields = { reason: reason.value.trim() || "stopped on the page" };
    await this.give("stop", fields, `Stop ${this.runName}`);
  }

  /** The names of the places and transitions at which a robot stops. */
  get breakpoints() {
    return this.model.info.breakpoints || [];
  }

  /** The button that sets or removes the breakpoint of a node; null if no robot can stop there. */
  breakpoint(node) {
    const { breakpoints } = this;
    const has = breakpoints.includes(node.name);
    if (!node.breakable && !has) return null;
    const names = has
      ? breakpoints.filter((name) => name !== node.name)
      : [...breakpoints, node.name];
    const says = `${has ? "Remove" : "Set"} breakpoint`;
    return this.button(
      says,
      "breakpoints",
      () => this.give("breakpoints", { names }, `${says} at ${node.name}`),
      { about: node.name, title: "A robot that comes here stops until it is resumed" },
    );
  }

  /** Let a task in by a transition of the environment. */
  async submit(transition) {
    const { model } = this;
    const field = (id, label, element) =>
      h("div", { class: "form" }, h("label", { for: id, text: label }), element);
    const id = h("input", {
      type: "text",
      id: "task-id",
      maxlength: 200,
      autocomplete: "off",
      placeholder: "made up by the server",
    });
    const data = h("textarea", { id: "task-data", rows: 5, spellcheck: "false" });
    data.value = "{}";
    await ask(
      `Submit a task by “${transition}”`,
      [
        h("p", {
          text: "Of several tasks with one id, the first counts. Actions read the data as task.NAME.",
        }),
        field("task-id", "Id", id),
        field("task-data", "Data, a JSON object", data),
      ],
      [
        ["Cancel", ""],
        ["Submit", "submit", "primary"],
      ],
      async () => {
        const fields = { transition, id: id.value.trim(), data: jsonObject(data.value) };
        if (this.model === model && !(await this.give("submit", fields, `Submit ${transition}`)))
          throw new Error(this.given[0].answer);
      },
    );
  }

  /** The rarer orders for one robot, each with its description. */
  async more(robot) {
    const { scene } = this.model;
    const places = scene.places.filter(({ kind }) => kind === "action");
    const present = scene.places[robot.place]?.name;
    const place = h(
      "select",
      { "aria-label": "Place" },
      places.map(({ name }) =>
        h("option", { value: name, text: name, selected: name === present }),
      ),
    );
    const row = (command, label, does, kind, ...fields) =>
      this.offers(command) &&
      h(
        "div",
        { class: "choice" },
        h("p", {}, does),
        h(
          "div",
          { class: "buttons" },
          fields,
          h("button", {
            text: label,
            class: kind,
            value: command,
            onclick: (event) => event.target.closest("dialog").close(command),
          }),
        ),
      );
    const answer = await ask(
      `Orders for ${robot.name}`,
      [
        h("p", {
          class: "muted",
          text: `Run “${this.runName}”; ${robot.name} is in ${present || "no place"}.`,
        }),
        row(
          "set_place",
          "Set place",
          "Set its place, for example after somebody carried it. The action there starts.",
          "",
          place,
        ),
        row(
          "leave",
          "Leave the team",
          "It leaves the team voluntarily and takes its token along.",
          "",
        ),
        row(
          "evict",
          "Evict",
          "Remove it from the team as lost, if it will not come back by itself.",
          "danger",
        ),
      ],
      [["Cancel", ""]],
    );
    if (answer === "set_place")
      await this.give(
        "set_place",
        { robot: robot.name, place: place.value },
        `Move ${robot.name} to ${place.value}`,
      );
    if (answer === "leave")
      await this.give("leave", { robot: robot.name }, `Make ${robot.name} leave`);
    if (answer === "evict") await this.evict(robot.name);
  }

  /** Evict a robot; of one that acts, ask first. */
  async evict(name) {
    const { model } = this;
    const robot = model.board.robots.get(name);
    const place = model.scene.places[robot?.place]?.name;
    const { word } = reportOf(robot?.phase);
    const sure = await ask(
      `Evict ${name} from the run “${this.runName}”?`,
      h("p", {
        text: [
          `${name}${place ? ` is in ${place}` : ""}${word ? `: it ${word}` : ""}.`,
          "The team goes on without it, and its token is taken out of the net.",
          "What it is doing is cancelled once it hears of that.",
        ].join(" "),
      }),
      [
        ["Cancel", "", "primary"],
        [`Evict ${name}`, "evict", "danger"],
      ],
    );
    if (sure === "evict" && this.model === model)
      await this.give("evict", { robot: name }, `Evict ${name}`);
  }

  /** The buttons on the card of a robot. */
  ofRobot(robot) {
    const is = reportOf(robot.phase);
    if (is.gone || is.at_rest) return [];
    const { name } = robot;
    const simple = (label, command, title, says = `${label} ${name}`, kind = "") =>
      this.button(label, command, () => this.give(command, { robot: name }, says), {
        about: name,
        kind,
        title,
      });
    const rare = RARE.find((command) => this.offers(command));
    return [
      is.failed &&
        simple(
          "Try again",
          "retry",
          "Start its action again",
          `Retry the action of ${name}`,
          "primary",
        ),
      robot.paused
        ? simple("Resume", "resume", "")
        : simple(
            "Pause",
            "pause",
            "It takes part in no firing until it is resumed; its action continues",
          ),
      rare &&
        this.button("More …", rare, () => this.more(robot), {
          about: name,
          title: "Set its place, make it leave, evict it",
        }),
    ].filter(Boolean);
  }
}
