// Pointer actions on the net: select, drag a node, drag the view, zoom with the wheel or two fingers.

export const STILL = 4; // px that the pointer may move during a click
export const AGAIN = 400; // ms within which a second click is a double click

export class Pointer {
  constructor(view) {
    this.view = view;
    this.gesture = null;
    this.fingers = new Map(); // pointer -> where it is
    this.pinch = null;
    const { container } = view;
    container.onwheel = (event) => this.wheel(event);
    container.onpointerdown = (event) => this.pinches(event) || this.down(event);
    container.onpointermove = (event) => this.pinches(event) || this.move(event);
    container.onpointerup = container.onpointercancel = (event) =>
      this.pinches(event) || this.up(event);
  }

  /** Whether an event is part of a gesture of two fingers, which drag and zoom the view. */
  pinches(event) {
    if (event.pointerType !== "touch") return false;
    const { fingers, view } = this;
    const [down, moves] = [event.type === "pointerdown", event.type === "pointermove"];
    const pinched = this.pinch !== null;
    if (down || (moves && fingers.has(event.pointerId)))
      fingers.set(event.pointerId, this.point(event));
    else if (!moves) fingers.delete(event.pointerId);
    if (fingers.size !== 2) {
      this.pinch = null;
      return pinched || fingers.size > 2;
    }
    const [a, b] = [...fingers.values()];
    const now = {
      apart: Math.hypot(a[0] - b[0], a[1] - b[1]) || 1,
      middle: [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2],
    };
    if (down) {
      this.cancel();
      this.pinch = { ...now, camera: { ...view.camera.now } };
      view.container.setPointerCapture(event.pointerId);
    } else if (this.pinch) {
      const { apart, middle, camera } = this.pinch;
      const k = camera.k * (now.apart / apart);
      view.camera.fitted = false;
      view.camera.set(
        k,
        now.middle[0] - ((middle[0] - camera.x) * k) / camera.k,
        now.middle[1] - ((middle[1] - camera.y) * k) / camera.k,
      );
    }
    return true;
  }

  /** End a gesture that has become another one. */
  cancel() {
    if (this.gesture?.moved && this.gesture.node) this.view.dropNode(this.gesture.node);
    this.gesture = null;
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
      this.pan(gesture.camera, dx, dy);
      return;
    }
    const { k } = view.camera.now;
    view.moveNode(gesture.node, gesture.start[0] + dx / k, gesture.start[1] + dy / k);
  }

  /** Drag the view from where it was. */
  pan({ k, x, y }, dx, dy) {
    const { camera } = this.view;
    camera.fitted = false;
    camera.set(k, x + dx, y + dy);
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
