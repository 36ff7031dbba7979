// The robots panel: the colour and id of each robot, what it does and since when, why it waits, and the possible
// orders.

import { ModelPanel } from "./model_panel.js";
import { h, $, natural, seconds } from "./dom.js";
import { colourOf, shortName } from "./colours.js";
import { reportOf, robotReport } from "./phases.js";
import { dataLines, robotExtras } from "./reacting.js";
import { RestingList } from "./resting_list.js";

const PAUSE = 250; // ms between two drawings

/** How long a robot has been in its phase. */
function since(model, robot) {
  if (
    reportOf(robot.phase).gone ||
    (!robot.phase && !robot.paused) ||
    robot.since === undefined ||
    robot.since === null
  )
    return "";
  return seconds(Math.max(0, model.now() - robot.since));
}

export function robotCard(model, robot, buttons = []) {
  const place = robot.place >= 0 ? model.scene.places[robot.place] : null;
  const ended = Boolean(model.board.status.ended);
  const { word, tone } = robotReport(robot, model.board.status);
  const disc = h("span.disc", { text: shortName(robot.name), "aria-hidden": "true" });
  disc.style.background = colourOf(robot.name);
  const feedback =
    model.following && !ended && !reportOf(robot.phase).gone ? feedbackOf(model, robot) : null;
  const extras = robotExtras(robot);
  const attempt = robot.attempt > 1 ? `, attempt ${robot.attempt}` : "";
  return h(
    "div",
    {
      class: `robot-card is-${robot.phase} ${reportOf(robot.phase).tone}`,
      "data-robot": robot.name,
    },
    disc,
    h(
      "div",
      h("div.line", h("strong", robot.name), h("span", { class: `badge ${tone}`, text: word })),
      h(
        "div.line.muted",
        h(
          "span",
          place
            ? `${reportOf(robot.phase).gone || ended ? "was in " : ""}${place.name}${attempt}`
            : "",
        ),
        h("span.since", ended ? "" : since(model, robot)),
      ),
    ),
    robot.paused && !ended && place && (model.info.breakpoints || []).includes(place.name)
      ? h("div.held", "stops at a breakpoint, until it is resumed")
      : null,
    robot.why && !ended ? h("div.why", robot.why) : null,
    robot.refused ? h("div.why", refusedText(robot.refused)) : null,
    feedback ? h("div.feedback", feedback) : null,
    extras.length > 0 && h("div.extras", extras),
    buttons.length > 0 && h("div.buttons", buttons),
  );
}

/** The kinds of messages that a robot refused most often. */
function refusedText(refused) {
  const kinds = refused.slice(0, 3).map((kind) => {
    const sender = kind.robot || "somebody";
    return `${kind.times} of ${sender} (${kind.why})`;
  });
  return `refused: ${kinds.join(", ")}${refused.length > 3 ? " …" : ""}`;
}

function feedbackOf(model, robot) {
  return new Map(Object.entries(model.latest.feedback || {})).get(robot.name);
}

export class RobotsPanel extends RestingList {
  /** `orders`: the orders that an operator may give. */
  constructor(model, orders) {
    super($("robots"), PAUSE);
    this.model = model;
    this.orders = orders;
    this.comparison = new ModelPanel(model);
    // name -> {element, looks}: a card is only redrawn if it has changed, so that its buttons stay in place
    this.cards = new Map();
    this.update();
    this.clock = setInterval(() => {
      if (!this.list.hidden && model.mode === "LIVE" && model.lostAt === null) this.update();
    }, 1000);
    this.onGiven = () => this.later();
    orders.addEventListener("given", this.onGiven);
  }

  draw() {
    const { model, orders, list: panel } = this;
    if (panel.hidden || !model.board) return;
    const focused = panel.contains(document.activeElement)
      ? document.activeElement.dataset.focus
      : null;
    const robots = [...model.board.robots.values()].sort((a, b) => natural(a.name, b.name));
    const cards = robots.map((robot) => this.card(robot));
    for (const name of [...this.cards.keys()])
      if (!model.board.robots.has(name)) this.cards.delete(name);
    if (!cards.length) {
      cards.push(
        h(
          "p.muted",
          model.mode === "SIMULATE"
            ? "A simulation moves anonymous tokens. Robots appear in a live run or a replay."
            : model.head.status.stalled
              ? "No robot is left."
              : "No robot has been heard from yet.",
        ),
      );
    }
    const content = [
      this.look(),
      ...cards,
      this.team(),
      this.comparison.element(),
      orders.list(),
    ].filter(Boolean);
    const same =
      content.length === panel.children.length &&
      content.every((element, i) => element === panel.children[i]);
    if (!same) panel.replaceChildren(...content);
    if (focused && !panel.contains(document.activeElement)) {
      const again = [...panel.querySelectorAll("[data-focus]")].find(
        (element) => element.dataset.focus === focused && !element.disabled,
      );
      (again || panel).focus();
    }
  }

  /** Show a read-only viewer why there are no buttons. */
  look() {
    if (this.model.mode !== "LIVE" || !this.orders.refusal || this.model.head.status.ended)
      return null;
    const text = `No orders: ${this.orders.refusal}.`;
    if (this.looking?.textContent !== text) this.looking = h("p.muted", text);
    return this.looking;
  }

  /** The data of the team. */
  team() {
    const { team } = this.model.board.data || {};
    if (!team || !Object.keys(team).length) return null;
    if (this.teamData !== team) {
      this.teamData = team;
      this.teamShown = h("section.team-data", h("h3", "Data of the team"), dataLines(team));
    }
    return this.teamShown;
  }

  card(robot) {
    const { model, orders } = this;
    const buttons = model.mode === "LIVE" ? orders.ofRobot(robot) : [];
    const looks = JSON.stringify([
      robot,
      model.info.breakpoints,
      model.board.status.ended,
      model.following,
      buttons.map((b) => [b.textContent, b.disabled]),
    ]);
    const known = this.cards.get(robot.name);
    const feedback = model.following && !model.board.status.ended ? feedbackOf(model, robot) : null;
    if (known && known.looks === looks && Boolean(feedback) === known.fed) {
      if (!model.board.status.ended)
        known.element.querySelector(".since").textContent = since(model, robot);
      if (feedback) known.element.querySelector(".feedback").textContent = feedback;
      return known.element;
    }
    const element = robotCard(model, robot, buttons);
    this.cards.set(robot.name, {
      element,
      looks,
      fed: Boolean(element.querySelector(".feedback")),
    });
    return element;
  }

  close() {
    this.orders.removeEventListener("given", this.onGiven);
    clearInterval(this.clock);
    super.close();
  }
}
