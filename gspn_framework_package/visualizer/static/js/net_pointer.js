// Pointer actions on the net: select, drag a node, drag the view, zoom with the wheel.

const STILL = 4; // px that the pointer may move during a click
const AGAIN = 400; // ms within which a second click is a double click

export class Pointer {
  constructor(view) {
    this.view = view;
    this.gesture = null;
    const { container } = view;
    container.onwheel = (event) => this.wheel(event);
    container.onpointerdown = (event) => this.down(event);
    container.onpointermove = (event) => this.move(event);
    container.onpointerup = container.onpointercancel = (event) => this.up(event);
  }

  point(event) {
    const box = this.view.container.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  hit(target) {
    const element = target.closest("[data-place], [data-transition]");
    if (!element) return null;
    const { place, transition } = element.dataset;
    return place !== undefined
      ? { kind: "place", index: Number(place) }
      : { kind: "transition", index: Number(transition) };
  }

  wheel(event) {
    event.preventDefault();
    const pixels = event.deltaY * (event.deltaMode ? 20 : 1);
    this.view.camera.zoom(
      Math.exp(-Math.max(-60, Math.min(60, pixels)) / 220),
      ...this.point(event),
    );
  }

  down(event) {
    if (event.button !== 0 && event.button !== 1) return;
    const { view } = this;
    view.camera.stop();
    const hit = event.button === 0 ? this.hit(event.target) : null;
    this.gesture = {
      hit,
      node: hit && view.nodeOf(hit),
      at: this.point(event),
      camera: { ...view.camera.now },
      moved: false,
    };
    view.container.setPointerCapture(event.pointerId);
  }

  move(event) {
    const { gesture, view } = this;
    if (!gesture) return;
    const [x, y] = this.point(event);
    const [dx, dy] = [x - gesture.at[0], y - gesture.at[1]];
    if (!gesture.moved && Math.hypot(dx, dy) < STILL) return;
    if (!gesture.moved) {
      gesture.moved = true;
      if (gesture.node) gesture.start = [gesture.node.x, gesture.node.y];
      view.container.classList.add("dragging");
    }
    if (!gesture.node) {
      const { k, x: x0, y: y0 } = gesture.camera;
      view.camera.fitted = false;
      view.camera.set(k, x0 + dx, y0 + dy);
      return;
    }
    const { k } = view.camera.now;
    view.moveNode(gesture.node, gesture.start[0] + dx / k, gesture.start[1] + dy / k);
  }

  up(event) {
    const { gesture, view } = this;
    this.gesture = null;
    view.container.classList.remove("dragging");
    if (!gesture) return;
    if (gesture.moved) {
      if (gesture.node) view.dropNode(gesture.node);
      return;
    }
    if (event.type !== "pointerup") return;
    view.dispatchEvent(new CustomEvent("select", { detail: gesture.hit }));
    const now = performance.now(),
      last = this.lastClick;
    this.lastClick = { at: now, node: gesture.node };
    if (gesture.hit && last && now - last.at < AGAIN && last.node === gesture.node) {
      view.dispatchEvent(new CustomEvent("activate", { detail: gesture.hit }));
    }
  }
}
