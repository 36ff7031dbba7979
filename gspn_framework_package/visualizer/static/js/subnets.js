// Subnets of a plan: each folds into one node, which stands for all its places. That node is the subnet's entry, under
// the subnet's name; the others are hidden. An unfolded subnet is drawn as in its own plan, around its entry, and
// pushes the nodes around it aside. A list of buttons folds and unfolds, and counts the robots. Groups of nodes
// have boxes too.

import { h, s } from "./dom.js";
import { boxesAround } from "./net_nodes.js";

export class Subnets {
  /** `list`: the element for the buttons. Initially, subnets with more than one node are folded. */
  constructor(view, list) {
    this.view = view;
    this.list = list;
    const nodesOf = ({ places, transitions }) => [
      ...places.map((p) => view.places[p]),
      ...transitions.map((t) => view.transitions[t]),
    ];
    this.groups = (view.scene.groups || []).map((group) => ({ ...group, nodes: nodesOf(group) }));
    this.all = (view.scene.subnets || []).map((subnet) => ({
      ...subnet,
      inside: new Set(nodesOf(subnet)),
      folded: subnet.places.length + subnet.transitions.length > 1,
    }));
    this.all.forEach((subnet, i) => {
      const entry = view.places[subnet.entry];
      subnet.around = this.all.slice(0, i).findLast((other) => other.inside.has(entry));
    });
    this.boxes = s("g.boxes");
    this.standsFor = new Map(); // entry -> the folded subnet that it stands for
    this.behind = new Map(); // place -> entry of the folded subnet that it is in
    this.buttons = this.all.map((subnet) =>
      h("button", { "data-subnet": subnet.name, onclick: () => this.fold(subnet, !subnet.folded) }),
    );
    list.replaceChildren(...this.buttons);
    list.hidden = !this.all.length;
  }

  /** Hide folded subnets and set the position of every node. Must run before arcs are routed. */
  apply() {
    const { view } = this;
    for (const node of view.nodes) {
      [node.x, node.y] = node.home;
      node.folded = null;
      node.title = node.name;
    }
    this.standsFor.clear();
    this.behind.clear();
    const hidden = new Set();
    for (const subnet of this.all) {
      const entry = view.places[subnet.entry];
      if (!subnet.folded || hidden.has(entry)) continue; // inside another one
      for (const node of subnet.inside) {
        hidden.add(node);
        node.folded = entry;
      }
      for (const p of subnet.places) this.behind.set(p, subnet.entry);
      this.standsFor.set(subnet.entry, subnet);
      entry.title = subnet.name;
    }
    for (const subnet of [...this.all].reverse()) this.makeRoom(subnet);
    for (const node of view.nodes)
      if (node.folded) [node.x, node.y] = [node.folded.x, node.folded.y];
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

  /** Draw a box around each unfolded subnet, and around each group that is not inside a folded one. */
  drawBoxes() {
    const open = this.all.filter(({ folded, entry }) => !folded && !this.view.places[entry].folded);
    const groups = this.groups.filter(({ nodes }) => {
      const around = this.standsFor.get(nodes[0].folded?.index);
      return !around || nodes.length >= around.inside.size;
    });
    this.boxes.replaceChildren(
      ...boxesAround([
        ...groups.map(({ name, nodes }) => [name, nodes]),
        ...open.map(({ name, inside }) => [name, [...inside]]),
      ]),
    );
  }

  /** Push the surrounding nodes away from an unfolded subnet as far as its drawing extends from its entry. */
  makeRoom(subnet) {
    const entry = this.view.places[subnet.entry];
    if (entry.folded) return;
    const beside = this.all.filter((other) => other !== subnet && other.around === subnet.around);
    const around = [...(subnet.around?.inside || this.view.nodes)].filter(
      (node) => !subnet.inside.has(node),
    );
    for (const axis of ["x", "y"]) {
      const reach = [...subnet.inside].map((node) => node[axis] - entry[axis]);
      const [low, high] = [Math.min(...reach), Math.max(...reach)];
      const pushes = around.map((node) => {
        const other = beside.find(({ inside }) => inside.has(node)); // another unfolded subnet stays in one piece
        const at = (other ? this.view.places[other.entry] : node)[axis] - entry[axis];
        return at > 0 ? high : at < 0 ? low : 0;
      });
      around.forEach((node, i) => (node[axis] += pushes[i]));
    }
  }

  fold(subnet, folded) {
    subnet.folded = folded;
    this.view.refold();
  }

  /** Unfold the subnets that hide a node the user wants to see. */
  show(node) {
    if (!node?.folded || node.folded === node) return;
    const kind = node.kind === "place" ? "places" : "transitions";
    for (const subnet of this.all) if (subnet[kind].includes(node.index)) subnet.folded = false;
    this.view.refold();
  }

  /** The tokens to draw in a place; for a folded subnet, those of all its robot places. */
  tokens(p, count) {
    const subnet = this.standsFor.get(p);
    return subnet ? subnet.robots.reduce((sum, inner) => sum + count(inner), 0) : count(p);
  }

  /** Show the number of robots on the buttons: the number of their tokens, whether or not they have been heard from. */
  count(board) {
    this.all.forEach((subnet, i) => {
      const inside = subnet.robots.reduce((sum, p) => sum + board.marking[p], 0);
      const text = `${subnet.name}: ${inside} ${inside === 1 ? "robot" : "robots"}`;
      if (this.buttons[i].textContent !== text) this.buttons[i].textContent = text;
    });
  }
}
