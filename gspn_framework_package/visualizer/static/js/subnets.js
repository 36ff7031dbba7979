// Subnets of a plan: each folds into one node, which stands for all its places. That node is the subnet's entry, under
// the name of the subnet; the others are hidden behind it. A list of buttons folds and unfolds, and counts the robots.

import { h } from "./dom.js";
import { told } from "./phases.js";

export class Subnets {
  /** `list`: the element for the buttons. A subnet of more than one place is folded at first. */
  constructor(view, list) {
    this.view = view;
    this.list = list;
    this.all = (view.scene.subnets || []).map((subnet) => ({
      ...subnet,
      inside: new Set(subnet.places),
      folded: subnet.places.length > 1,
    }));
    this.standsFor = new Map(); // entry -> the folded subnet that it stands for
    this.behind = new Map(); // place -> entry of the folded subnet that it is in
    this.buttons = this.all.map((subnet) =>
      h("button", { "data-subnet": subnet.name, onclick: () => this.fold(subnet, !subnet.folded) }),
    );
    list.replaceChildren(...this.buttons);
    list.hidden = !this.all.length;
  }

  /** Hide what is folded, and put it where its subnet is drawn. Before arcs are routed. */
  apply() {
    const { view } = this;
    for (const node of view.nodes) {
      if (node.own) [node.x, node.y] = node.own;
      node.own = null;
      node.folded = null;
      node.title = node.name;
    }
    this.standsFor.clear();
    this.behind.clear();
    const hidden = new Set();
    for (const subnet of this.all) {
      const entry = view.places[subnet.entry];
      if (!subnet.folded || hidden.has(entry)) continue; // inside another one
      const within = [
        ...subnet.places.map((p) => view.places[p]),
        ...subnet.transitions.map((t) => view.transitions[t]),
      ];
      for (const node of within) {
        hidden.add(node);
        node.own = [node.x, node.y];
        node.folded = entry;
        [node.x, node.y] = [entry.x, entry.y];
      }
      for (const p of subnet.places) this.behind.set(p, subnet.entry);
      this.standsFor.set(subnet.entry, subnet);
      entry.title = subnet.name;
    }
    for (const node of view.nodes) {
      const away = Boolean(node.folded) && node.folded !== node;
      node.element.classList.toggle("folded-away", away);
      node.element.classList.toggle("subnet", node.folded === node);
      node.element.querySelector("title").textContent = node.title;
      node.text = undefined;
      node.label?.remove();
      node.label = null;
    }
    this.all.forEach((subnet, i) => {
      this.buttons[i].setAttribute("aria-expanded", String(!subnet.folded));
    });
  }

  fold(subnet, folded) {
    subnet.folded = folded;
    this.view.refold();
  }

  /** Unfold whatever hides a node, which somebody wants to see. */
  show(node) {
    if (!node?.folded || node.folded === node) return;
    const kind = node.kind === "place" ? "places" : "transitions";
    for (const subnet of this.all) if (subnet[kind].includes(node.index)) subnet.folded = false;
    this.view.refold();
  }

  /** The tokens to draw in a place: those of all robots' places where it stands for a subnet. */
  tokens(p, count) {
    const subnet = this.standsFor.get(p);
    return subnet ? subnet.robots.reduce((sum, inner) => sum + count(inner), 0) : count(p);
  }

  /** Write the number of robots on the buttons. */
  count(board) {
    const robots = [...board.robots.values()].filter(
      ({ place, phase }) => place >= 0 && told(phase).shown && !told(phase).gone,
    );
    this.all.forEach((subnet, i) => {
      const inside = robots.filter(({ place }) => subnet.inside.has(place)).length;
      const text = `${subnet.name}: ${inside} ${inside === 1 ? "robot" : "robots"}`;
      if (this.buttons[i].textContent !== text) this.buttons[i].textContent = text;
    });
  }
}
