// A small picture of the whole net that marks the part in view; it is shown while part of the net is out of view. A
// click or a drag in it moves the view.

import { s } from "./dom.js";

export class Minimap {
  /** `camera`: that of the view, which calls `draw` when it moves, and `rest` when it rests. */
  constructor(camera) {
    this.camera = camera;
    this.bounds = null; // of the net, when the view last rested
    this.all = true; // whether all of it is in view
    this.dots = s("path");
    this.part = s("rect");
    const look = (event) => event.buttons && this.look(event);
    this.element = s(
      "svg.minimap",
      { "aria-hidden": "true", hidden: true, onpointerdown: look, onpointermove: look },
      this.dots,
      this.part,
    );
    camera.view.container.after(this.element);
  }

  look({ clientX, clientY }) {
    const { camera } = this;
    const { k } = camera.now;
    const { width, height } = camera.size;
    const { x, y } = new DOMPoint(clientX, clientY).matrixTransform(
      this.element.getScreenCTM().inverse(),
    );
    camera.stop();
    camera.fitted = false;
    camera.set(k, width / 2 - k * x, height / 2 - k * y);
  }

  /** Show which part is in view. */
  draw() {
    if (!this.bounds) return;
    const { k, x, y } = this.camera.now;
    const { width, height } = this.camera.size;
    const shown = { x: -x / k, y: -y / k, width: width / k, height: height / k };
    for (const [name, value] of Object.entries(shown)) this.part.setAttribute(name, value);
    const [left, top, right, bottom] = this.bounds;
    this.all =
      shown.x <= left &&
      shown.y <= top &&
      shown.x + shown.width >= right &&
      shown.y + shown.height >= bottom;
    this.element.toggleAttribute("hidden", this.all);
  }

  /** Show where the nodes are now. */
  rest() {
    const { nodes } = this.camera.view;
    const [left, top, right, bottom] = (this.bounds = this.camera.view.bounds());
    this.draw();
    if (this.all) return;
    this.element.setAttribute("viewBox", [left, top, right - left, bottom - top].join(" "));
    this.dots.setAttribute("d", nodes.map(({ x, y }) => `M${x} ${y}h0`).join(""));
  }
}
