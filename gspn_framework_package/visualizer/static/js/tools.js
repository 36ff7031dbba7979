// The tools above the net: those of thesis Figure 5.4 in a simulation, controls of the view in a live run or a replay.

import { h, $, ask, attempt, announce, menu, table, toast, plural, number } from "./dom.js";
import { post } from "./api.js";
import { ONLY_LOOK } from "./orders.js";

/** The simulation as the stage of a firing sequence (sequence.js) from `start`, a marking; null: the initial one. The
 * sequence fires as a team does: an immediate transition does not wait for others of higher priority. */
export function simulationStage(page, start) {
  const { model } = page;
  const simulate = (command, fields) => {
    if (page.model !== model) return Promise.resolve(null); // another net is open by now
    if (model.mode === "SIMULATE") return page.tools.simulate(command, fields);
    toast("firing sequences play in the simulation: press Simulate first");
    return Promise.resolve(null);
  };
  return {
    begin: () => {
      page.tools?.stopRunning();
      return start ? simulate("move", { marking: start }) : simulate("reset");
    },
    fire: (transition) => simulate("fire", { transition, any_priority: true }),
    back: () => simulate("back", { steps: 1 }),
  };
}

/** The name of a tool; the part between bars is hidden on a narrow page. */
const named = (text) => text.split("|").map((part, i) => (i % 2 ? h("span.wide", part) : part));

export class Tools {
  constructor(page) {
    this.page = page;
    this.steps = 10;
    this.build();
  }

  get model() {
    return this.page.model;
  }

  do(command, fields = {}) {
    if (!this.page.mayAct) throw new Error(ONLY_LOOK);
    return post("do", { command, ...fields }, { id: this.model.session.id });
  }

  async toNow() {
    if (!this.model.following) await this.model.backToLive();
  }

  // -- commands of a simulation --------------------------------------------------------------------

  simulate(command, fields) {
    return attempt(async () => {
      await this.toNow();
      return this.do(command, fields);
    });
  }

  async step(steps = 1) {
    const done = await this.simulate("step", { steps });
    if (done && done.dead) {
      this.stopRunning();
      const says = done.fired
        ? `${plural(done.fired, "step")}, then nothing is enabled`
        : "nothing is enabled: no step is possible";
      toast(says, true);
      announce(says);
    }
    return done;
  }

  back() {
    return this.simulate("back", { steps: 1 });
  }

  reset() {
    this.stopRunning();
    return this.simulate("reset").then(
      (done) => done && toast("Reset, for all viewers. Back (←) undoes it.", true),
    );
  }

  clear() {
    this.stopRunning();
    return this.simulate("clear").then((done) => done && announce("cleared"));
  }

  fire(index) {
    return this.simulate("fire", { transition: this.model.scene.transitions[index].name });
  }

  fireChosen() {
    const { selection } = this.page;
    if (selection?.kind !== "transition") {
      toast("select a transition first, in the net or the list", true);
      return null;
    }
    return this.fire(selection.index);
  }

  toggleRunning() {
    if (this.running) this.stopRunning();
    else this.startRunning();
  }

  startRunning() {
    this.running = true;
    this.refresh();
    const tick = async () => {
      if (!this.running) return;
      const begin = performance.now();
      const done = await this.step(1);
      if (!done || done.dead) {
        this.stopRunning();
        return;
      }
      this.timer = setTimeout(tick, Math.max(0, 1000 / this.speed - (performance.now() - begin)));
    };
    tick();
  }

  stopRunning() {
    this.running = false;
    clearTimeout(this.timer);
    this.refresh();
  }

  setProbability(index, value) {
    const { scene, info } = this.model;
    const probabilities = new Map(
      Object.entries(info.probabilities || {}).map(([t, p]) => [scene.transitions[t].name, p]),
    );
    const { name } = scene.transitions[index];
    if (String(value).trim() === "") probabilities.delete(name);
    else probabilities.set(name, Number(value));
    return this.simulate("probabilities", { probabilities: Object.fromEntries(probabilities) });
  }

  async probabilities() {
    const { model } = this;
    const { scene, info, board } = model;
    const choices = new Map(model.latest.choices || []);
    const inputs = new Map();
    const order = scene.transitions
      .map((t, index) => index)
      .sort((a, b) => board.enabled.has(b) - board.enabled.has(a));
    const rows = order.slice(0, 500).map((index) => {
      const transition = scene.transitions[index];
      const input = h("input", {
        type: "number",
        min: "0",
        step: "any",
        value: info.probabilities?.[String(index)] ?? "",
        "aria-label": `Firing probability of ${transition.name}`,
      });
      inputs.set(index, input);
      return [
        transition.name,
        h(
          "td",
          transition.timed
            ? `rate ${number(transition.rate)}`
            : `weight ${number(transition.weight)}`,
        ),
        choices.has(index) ? `${(choices.get(index) * 100).toFixed(1)} %` : "–",
        h("td", input),
      ];
    });
    await ask(
      "Firing probabilities",
      [
        h(
          "p.muted",
          "Relative to the other transitions enabled at the same time. Empty: by rate or weight. " +
            "They affect which transition fires, not when.",
        ),
        table("table", ["Transition", h("th", "In the net"), "Now", h("th", "Probability")], rows),
      ],
      [
        ["Cancel", ""],
        ["Use rates and weights", "none"],
        ["Set", "set", "primary"],
      ],
      async (answer) => {
        const probabilities = new Map();
        for (const [index, input] of answer === "set" ? inputs : []) {
          const { name } = scene.transitions[index];
          if (input.validity.badInput)
            throw new Error(`the firing probability of '${name}' is not a number`);
          if (input.value.trim() !== "") probabilities.set(name, Number(input.value));
        }
        await this.toNow();
        await this.do("probabilities", { probabilities: Object.fromEntries(probabilities) });
      },
    );
  }

  // -- the bar -------------------------------------------------------------------------------------

  build() {
    const { page } = this;
    const { mode } = this.model;
    this.speed = this.speed || 4;
    const { mayAct } = page;
    const button = (id, text, onclick, title, disabled = false) =>
      h("button", { id, title, onclick, disabled }, named(text));
    const act = (id, text, onclick, title) =>
      button(id, text, onclick, mayAct ? title : ONLY_LOOK, !mayAct);
    const speeds = (id, label, values, chosen, unit, set) => {
      const onchange = (event) => set(Number(event.target.value));
      const choices = values.map((value) => [value, `${value} ${unit}`]);
      const choice = menu(choices, { id, "aria-label": label, onchange });
      choice.value = chosen;
      return h("label", choice);
    };
    const rule = () => h("span.rule");
    let tools;
    if (mode === "SIMULATE") {
      tools = [
        act("back", "◂| Back|", () => this.back(), "Take a step back (←)"),
        act("step", "Step ▸", () => this.step(1), "Simulate 1 step (→)"),
        act("steps", "|n steps |▸▸", () => this.step(this.steps), "Simulate n steps (Shift+→)"),
        h(
          "label",
          h("input", {
            id: "n-steps",
            type: "number",
            min: 1,
            max: 10000,
            value: this.steps,
            "aria-label": "Number of steps",
            onchange: (event) => {
              this.steps = Math.max(
                1,
                Math.min(10000, Math.round(Number(event.target.value)) || 1),
              );
              event.target.value = this.steps;
            },
          }),
        ),
        act("run", "▶ Run", () => this.toggleRunning(), "Step repeatedly until stopped (Space)"),
        speeds("speed", "Steps a second", [1, 2, 4, 10, 30], this.speed, "/s", (speed) => {
          this.speed = speed;
        }),
        rule(),
        act(
          "fire-chosen",
          "Fire| selected|",
          () => this.fireChosen(),
          "Fire the selected transition (X)",
        ),
        act(
          "probabilities",
          "Probabilities| …|",
          () => this.probabilities(),
          "Set firing probabilities",
        ),
        rule(),
        act("reset", "Reset", () => this.reset(), "Back to the initial marking (R)"),
        act("clear", "Clear", () => this.clear(), "Remove every token from the net"),
      ];
    } else {
      tools = [
        button(
          "view-back",
          "◂",
          () => attempt(() => this.model.stepView(-1)),
          "Previous firing (←)",
        ),
        button("view-play", "", () => page.togglePause(), ""),
        button("view-step", "▸", () => attempt(() => this.model.stepView(1)), "Next firing (→)"),
        speeds(
          "view-speed",
          "Speed of the playback",
          [0.25, 0.5, 1, 2, 5, 20, 100],
          this.model.speed,
          "×",
          (speed) => {
            this.model.speed = speed;
          },
        ),
      ];
    }
    if (this.model.latest.room || this.model.latest.world)
      tools.push(
        button("show-room", "Room", () => page.room.toggle(), "The room and the robots in it"),
      );
    $("tools").replaceChildren(...tools);
    this.built = mode;
    this.refresh();
  }

  refresh() {
    const { model, page } = this;
    if (this.built !== model.mode) {
      this.running = false;
      this.build();
      return;
    }
    const run = $("run");
    if (run) run.textContent = this.running ? "❚❚ Stop" : "▶ Run";
    const play = $("view-play");
    const moving = model.following ? model.mode === "LIVE" : model.playing;
    if (play) {
      play.textContent = moving ? "❚❚ Pause the view" : "▶ Play";
      play.title = `${moving ? "Pause the view; the robots continue" : "Resume"} (Space)`;
    }
    const small = $("play");
    const on = model.mode === "SIMULATE" ? this.running : moving;
    small.textContent = on ? "❚❚" : "▶";
    small.setAttribute("aria-label", on ? "Pause the view" : "Play");
    $("show-enabled").setAttribute("aria-pressed", page.showEnabled);
  }
}
