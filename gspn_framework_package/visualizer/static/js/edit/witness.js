// Plays a firing sequence on the drawing of the editor, from the initial marking of the document. An edit ends it.

import { h, $ } from "../dom.js";
import { FiringSequence, sequenceControls } from "../sequence.js";

const FLASH = 450; // ms

export class Witness {
  /** `steps`: names of transitions; `known`: the markings before, between and after them ({place: tokens}), if known; a
   * step may then also be inside a subnet, or be the loss of a robot. */
  constructor(mode, steps, known = null) {
    this.mode = mode;
    this.known = known;
    this.markings = []; // place -> tokens, before each step fired; the present one is last
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
    const { places } = this.mode.document.net;
    this.markings = [
      this.known ? this.knownAt(0) : new Map(places.map(({ name, tokens }) => [name, tokens ?? 0])),
    ];
    this.show();
    return true;
  }

  /** The marking after a number of steps, or null. */
  knownAt(count) {
    const named = this.known[count];
    const { places } = this.mode.document.net;
    return named ? new Map(places.map(({ name }) => [name, named[name] ?? 0])) : null;
  }

  fire(name) {
    if (this.known) return this.fireKnown(name);
    const { net } = this.mode.document;
    const marking = this.markings[this.markings.length - 1];
    const after = new Map(marking);
    for (const { from, to, weight = 1, inhibitor } of net.arcs) {
      if (inhibitor) continue;
      if (to === name) after.set(from, after.get(from) - weight);
      if (from === name) after.set(to, after.get(to) + weight);
    }
    if (!net.transitions.some((t) => t.name === name) || [...after.values()].some((n) => n < 0)) {
      this.mode.say(`${name} cannot fire here: the net has changed since this was found.`);
      return false;
    }
    this.fired(name, after);
    return true;
  }

  fireKnown(name) {
    const after = this.knownAt(this.markings.length);
    if (after) this.fired(name, after);
    return Boolean(after);
  }

  fired(name, after) {
    this.markings.push(after);
    this.show();
    const { byKey } = this.mode.canvas;
    const node = byKey.get(`transition:${name}`) || byKey.get(`place:${name.split(".")[0]}`);
    node?.element.classList.add("flash");
    setTimeout(() => node?.element.classList.remove("flash"), FLASH);
    this.mode.say(name.startsWith("(") ? name.slice(1, -1) : `${name} fires`);
  }

  back() {
    if (this.markings.length < 2) return false;
    this.markings.pop();
    this.show();
    return true;
  }

  show() {
    this.mode.canvas.showTokens(this.markings[this.markings.length - 1]);
  }

  end() {
    this.sequence.stop();
    this.box.remove();
    if (this.mode.witness === this) this.mode.witness = null;
    this.mode.canvas.showTokens(null);
  }
}
