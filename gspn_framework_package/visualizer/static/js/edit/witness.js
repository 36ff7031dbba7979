// Plays a firing sequence on the drawing of the editor, from the initial marking of the document. An edit ends it.

import { h, $ } from "../dom.js";
import { FiringSequence, sequenceControls } from "../sequence.js";

const FLASH = 450; // ms

export class Witness {
  /** `steps`: names of transitions, also inside subnets, or losses of robots; `markings`: those before, between and
   * after them ({place: tokens}). */
  constructor(mode, steps, markings) {
    this.mode = mode;
    this.markings = markings;
    this.at = 0; // number of steps fired
    const sequence = new FiringSequence(steps, this);
    this.sequence = sequence;
    this.box = h(
      "div.ed-witness",
      { id: "ed-witness", role: "group", "aria-label": "Firings that lead to it" },
      sequenceControls(sequence),
      h("button", { text: "Close", onclick: () => this.end() }),
    );
    $("ed-frame").append(this.box);
    mode.document.addEventListener("change", () => this.end(), { once: true });
    sequence.play();
  }

  begin() {
    return this.show(0);
  }

  fire(name) {
    if (!this.show(this.at + 1)) return false;
    const { byKey } = this.mode.canvas;
    const node = byKey.get(`transition:${name}`) || byKey.get(`place:${name.split(".")[0]}`);
    node?.element.classList.add("flash");
    setTimeout(() => node?.element.classList.remove("flash"), FLASH);
    this.mode.say(name.startsWith("(") ? name.slice(1, -1) : `${name} fires`);
    return true;
  }

  back() {
    return this.show(this.at - 1);
  }

  /** Show the marking after a number of steps; returns whether it is known. */
  show(at) {
    const marking = this.markings[at];
    if (!marking) return false;
    this.at = at;
    const { places } = this.mode.document.net;
    this.mode.canvas.showTokens(new Map(places.map(({ name }) => [name, marking[name] ?? 0])));
    return true;
  }

  end() {
    this.sequence.stop();
    this.box.remove();
    if (this.mode.witness === this) this.mode.witness = null;
    this.mode.canvas.showTokens(null);
  }
}
