// The inspector describes the selected node. For a place: its tokens, and each robot there with its phase and since
// when. For a transition: kind, rate or weight, number of firings, why it is not enabled.

import { h, $, facts, isPressed, toast, seconds, plural, number } from "./dom.js";
import { get } from "./api.js";
import { reportOf } from "./phases.js";
import { queueOf, taskLine, waitingFor } from "./reacting.js";
import { robotCard } from "./robots_panel.js";

/** Whether a field contains something other than a number; if so, it reports this. */
function badNumber(field) {
  if (field.validity.badInput) toast("not a number: nothing was changed");
  return field.validity.badInput;
}

/** Fires "run-net", "fire" (detail index), "choose" (detail {kind, index, fly}), "probability" (detail {index, value}).
 * `orders`: the orders that an operator may give to a running team; `mayAct`: whether the viewer is one. */
export class Inspector extends EventTarget {
  constructor(model, orders, mayAct) {
    super();
    this.mayAct = mayAct;
    this.model = model;
    this.orders = orders;
    this.panel = $("inspector");
    this.selection = null;
    this.why = null; // the server's last answer for the selected transition
    this.update();
  }

  select(selection) {
    this.selection = selection;
    this.why = null;
    this.update();
  }

  /** Ask the server why the selected transition cannot fire at the moment shown. */
  async askWhy(index) {
    const { model } = this;
    const moment = `${model.epoch}:${model.board.n}:${index}`;
    if (this.why?.moment === moment || this.asking) return;
    this.asking = true;
    const answer = await get("reasons", {
      id: model.session.id,
      transition: model.scene.transitions[index].name,
      at: model.board.n,
    }).catch(() => null);
    this.asking = false;
    const wanted = this.selection?.kind === "transition" ? this.selection.index : null;
    if (answer && wanted === index) {
      this.why = { ...answer, moment };
      this.refresh();
    } else if (wanted !== null && wanted !== index) this.askWhy(wanted);
  }

  /** The last answer; greyed out if it is about another moment than the one shown. */
  reasons(enabled) {
    const { why, model } = this;
    if (!why || why.enabled !== enabled || !why.reasons.length) return null;
    return h(
      "ul",
      { class: `reasons ${why.at === model.board.n ? "" : "stale"}` },
      why.reasons.map((reason) => h("li", reason)),
    );
  }

  later() {
    if (!this.timer)
      this.timer = setTimeout(() => {
        this.timer = 0;
        this.refresh();
      }, 200);
  }

  close() {
    clearTimeout(this.timer);
    this.timer = -1; // this view is no longer drawn
  }

  /** Redraw, unless the user is typing or pressing a button. */
  refresh() {
    if (isPressed(this.panel)) {
      this.later();
      return;
    }
    if (!this.panel.contains(document.activeElement) || document.activeElement.tagName !== "INPUT")
      this.update();
  }

  update() {
    if (!this.model.board) return;
    const { selection } = this;
    const focus = this.panel.contains(document.activeElement)
      ? document.activeElement.dataset.focus
      : null;
    const content = !selection
      ? this.overview()
      : selection.kind === "place"
        ? this.place(selection.index)
        : this.transition(selection.index);
    this.panel.replaceChildren(...content.flat(2).filter(Boolean));
    if (focus) this.panel.querySelector(`[data-focus="${focus}"]`)?.focus();
    if (selection?.kind === "transition") this.askWhy(selection.index);
  }

  link(kind, index) {
    const name = (kind === "place" ? this.model.scene.places : this.model.scene.transitions)[index]
      .name;
    return h("button.link", {
      text: name,
      "data-focus": `${kind}${index}`,
      onclick: () =>
        this.dispatchEvent(new CustomEvent("choose", { detail: { kind, index, fly: true } })),
    });
  }

  overview() {
    const { scene, board, mode, session } = this.model;
    const fired = board.counts.reduce((sum, count) => sum + count, 0);
    const notes = [
      ...session.notes,
      ...(scene.plan ? scene.plan.notes.filter((note) => !session.notes.includes(note)) : []),
    ];
    return [
      h("h2", scene.name),
      facts([
        ["Places", String(scene.places.length)],
        [
          "Transitions",
          `${scene.transitions.length} (${scene.transitions.filter((t) => !t.timed).length} immediate)`,
        ],
        ["Arcs", String(scene.arcs.length)],
        ["Tokens", String(board.marking.reduce((sum, count) => sum + count, 0))],
        ["Enabled", String(board.enabled.size)],
        ["Firings", String(fired)],
        ["Time", seconds(board.t)],
        [
          "Robots",
          scene.plan
            ? String(board.robots.size || (mode === "LIVE" ? 0 : scene.plan.robots.length))
            : null,
        ],
        ["Synchronisation", scene.plan && mode !== "SIMULATE" ? scene.plan.synchronisation : null],
        ["Policy", scene.plan ? plural(scene.plan.policy_rows, "row") : null],
        [
          "Drawing",
          {
            file: "as in the file",
            dot: "laid out in layers",
            sfdp: "laid out by forces",
            grid: "on a grid",
          }[scene.layout.engine] || scene.layout.engine,
        ],
      ]),
      h("p.muted", "Select a place or a transition in the net or the list to see its details."),
      scene.plan &&
        this.mayAct &&
        h(
          "div.buttons",
          h("button", {
            id: "show-run-net",
            text: "Show the run net",
            title: "The net that the plan is while it runs: actions, requests and draws as places",
            "data-focus": "run-net",
            onclick: () => this.dispatchEvent(new CustomEvent("run-net")),
          }),
        ),
      notes.length > 0 && [h("h3", "Notes"), notes.map((note) => h("p.muted", note))],
      board.notes.length > 0 && [
        h("h3", "Reports"),
        board.notes
          .slice(-8)
          .reverse()
          .map((note) =>
            h(
              "p",
              h("span", {
                class: `badge ${note.level === "fault" ? "bad" : note.level === "warning" ? "warn" : ""}`,
                text: seconds(note.t),
              }),
              ` ${note.robot ? `${note.robot}: ` : ""}${note.text}`,
            ),
          ),
      ],
    ];
  }

  place(index) {
    const { scene, board } = this.model;
    const place = scene.places[index];
    const robots = [...board.robots.values()].filter(
      (robot) => robot.place === index && !reportOf(robot.phase).gone,
    );
    const breakpoint = this.orders.breakpoint(place);
    const kinds = {
      action: "action place",
      resource: place.queue
        ? "queue: its tokens are tasks, the oldest of the highest priority first"
        : "resource place: its tokens are counters",
      plain: "place",
    };
    const around = (title, leaving) => {
      const arcs = scene.arcs.filter(([p, , forth]) => p === index && Boolean(forth) === leaving);
      const found = [...new Set(arcs.map(([, t]) => t))];
      return (
        found.length > 0 && [h("h3", title), found.map((t) => h("p", this.link("transition", t)))]
      );
    };
    return [
      h("h2", place.name),
      h("p.muted", this.model.session.meanings[place.name] || kinds[place.kind]),
      facts([
        ["Tokens", String(board.marking[index])],
        ["Initial tokens", String(place.tokens)],
        ["Capacity", place.capacity === null ? "unlimited" : String(place.capacity)],
        ["Action", place.action || (place.kind === "action" ? "none: done immediately" : null)],
      ]),
      breakpoint && h("div.buttons", breakpoint),
      place.queue && this.queue(place, board.marking[index]),
      robots.length > 0 && [
        h("h3", "Robots here"),
        robots.map((robot) => robotCard(this.model, robot)),
      ],
      around("Filled by", false),
      around("Consumed or tested by", true),
    ];
  }

  /** The tasks in a queue, the next one first. */
  queue(place, tokens) {
    const tasks = queueOf(this.model.board, place.name);
    return [
      h("h3", "Tasks"),
      tasks.length
        ? tasks.map((task) => taskLine(task, this.orders.ofTask(task)))
        : h("p.muted", "none known"),
      tasks.length > 0 &&
        tasks.length < tokens &&
        h("p.muted", `and ${tokens - tasks.length} more`),
    ].filter(Boolean);
  }

  transition(index) {
    const { scene, board, mode, info, latest } = this.model;
    const transition = scene.transitions[index];
    const enabled = board.enabled.has(index);
    const choice = (latest.choices || []).find(([t]) => t === index);
    const servers =
      transition.servers === null
        ? ", infinitely many servers"
        : transition.servers > 1
          ? `, ${transition.servers} servers`
          : "";
    const fields = { transition: transition.name };
    const fires = transition.environment ? this.orders.buttons("transition", fields) : [];
    for (const button of fires) button.disabled ||= !enabled;
    const submits = transition.submits ? this.orders.buttons("entrance", fields) : [];
    const breakpoint = this.orders.breakpoint(transition);
    const waiting = waitingFor(board, transition.name);
    const mine = info.probabilities?.[String(index)];
    const meaning = this.model.session.meanings[transition.name];
    const around = (title, forth) => {
      const arcs = scene.arcs.filter(([, t, direction]) => t === index && direction === forth);
      const says = (weight, inhibitor) =>
        inhibitor ? ` (inhibits at ${weight} or more)` : weight > 1 ? ` × ${weight}` : "";
      return (
        arcs.length > 0 && [
          h("h3", title),
          arcs.map(([p, , , weight, inhibitor]) =>
            h("p", this.link("place", p), says(weight, inhibitor)),
          ),
        ]
      );
    };
    return [
      h("h2", transition.name),
      meaning && h("p.muted", meaning),
      h(
        "p",
        h("span", {
          class: `badge ${enabled ? "good" : ""}`,
          text: enabled ? "enabled" : "not enabled",
        }),
      ),
      this.reasons(enabled),
      facts([
        ["Kind", transition.timed ? "exponential" : "immediate"],
        ["Rate", transition.timed ? `${number(transition.rate)} /s${servers}` : null],
        [
          "Weight",
          transition.timed
            ? null
            : transition.weight === 0
              ? "0: the policy chooses"
              : number(transition.weight),
        ],
        ["Priority", transition.timed ? null : String(transition.priority)],
        ["Event", transition.event],
        ["Tasks waiting outside", waiting.length ? waiting.join(", ") : null],
        ["Fired", plural(board.counts[index], "time")],
        [
          "Now",
          mode === "SIMULATE" && this.model.following && choice
            ? `${(choice[1] * 100).toFixed(1)} % chance to fire next`
            : null,
        ],
      ]),
      mode === "SIMULATE" && [
        h(
          "div.buttons",
          h("button.primary", {
            text: "Fire",
            disabled: !enabled || !this.model.following,
            title: this.model.following ? "" : "This is a past state: go back to now first",
            "data-focus": "fire",
            onclick: () => this.dispatchEvent(new CustomEvent("fire", { detail: index })),
          }),
        ),
        h(
          "div.form",
          h("label", { for: "probability", text: "Firing probability" }),
          h("input", {
            id: "probability",
            type: "number",
            min: "0",
            step: "any",
            value: mine ?? "",
            placeholder: transition.timed ? "by its rate" : "by its weight",
            "data-focus": "probability",
            title: "Relative to the other enabled transitions; empty: by rate or weight",
            onchange: (event) =>
              !badNumber(event.target) &&
              this.dispatchEvent(
                new CustomEvent("probability", { detail: { index, value: event.target.value } }),
              ),
          }),
        ),
      ],
      (fires.length > 0 || submits.length > 0 || breakpoint) &&
        h("div.buttons", fires, submits, breakpoint),
      around("Inputs", 1),
      around("Outputs", 0),
    ];
  }
}
