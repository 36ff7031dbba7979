// A palette of parts that plans are often made of: a click adds one, and people drag its picture into the drawing.

import { $, h, s } from "../dom.js";

/** Name -> its nodes, and its arcs from each node to the next. A letter before the name of a node gives its kind: P a
 * place of robots, R a resource place, T a timed and I an immediate transition. Its position (px), tokens and capacity
 * follow the name. */
const PARTS = {
  "Patrol cell": [
    "P Look 0 0,T seen 80 0,P Decide 160 0,I stay 80 70,I go 240 0",
    "Look seen Decide stay Look,Decide go",
  ],
  Lane: [
    "I enter 0 0,P Lane 80 0,T leave 160 0,R Lane_Free 80 70 1",
    "enter Lane leave Lane_Free enter",
  ],
  Charger: [
    "P Low 0 0,I plug_in 80 0,P Charge 160 0,T charged 240 0,R Charger 160 70 1",
    "Low plug_in Charge charged Charger plug_in",
  ],
  Queue: [
    "T order 0 0,R Orders 80 0 0 20,I take 160 0,P Idle 160 70,P Serve 240 0,T served 240 70",
    "order Orders take Serve served Idle take",
  ],
  Rendezvous: [
    "P First 0 0,P Second 0 70,I meet 80 35,P First_There 160 0,P Second_There 160 70",
    "First meet First_There,Second meet Second_There",
  ],
};
const MARGIN = 30; // px around a picture

/** A part of a net, as the clipboard has it. */
function partOf([nodes, chains]) {
  const part = { places: [], transitions: [], arcs: [], actions: {}, resources: [] };
  for (const text of nodes.split(",")) {
    const [kind, name, x, y, tokens, capacity] = text.split(" ");
    const node = { name, position: [Number(x), Number(y)] };
    if (kind === "T") part.transitions.push({ ...node, timed: true, rate: 1 });
    else if (kind === "I") part.transitions.push(node);
    else
      part.places.push({
        ...node,
        ...(tokens && { tokens: Number(tokens) }),
        ...(capacity && { capacity: Number(capacity) }),
      });
    if (kind === "P") part.actions[name] = null;
    if (kind === "R") part.resources.push(name);
  }
  for (const chain of chains.split(",")) {
    const names = chain.split(" ");
    part.arcs.push(...names.slice(1).map((to, i) => ({ from: names[i], to })));
  }
  return part;
}

function pictureOf({ places, transitions, arcs }) {
  const at = new Map([...places, ...transitions].map(({ name, position }) => [name, position]));
  const [right, bottom] = [0, 1].map((axis) => Math.max(...[...at.values()].map((p) => p[axis])));
  const size = [right + 2 * MARGIN, bottom + 2 * MARGIN];
  return s(
    "svg",
    { viewBox: [-MARGIN, -MARGIN, ...size].join(" "), "aria-hidden": "true" },
    arcs.map(({ from, to }) => s("path", { d: `M${at.get(from)}L${at.get(to)}` })),
    places.map(({ position: [cx, cy] }) => s("circle", { cx, cy, r: 20 })),
    transitions.map(({ position: [x, y], timed }) =>
      s(timed ? "rect.timed" : "rect", { x: x - 7, y: y - 20, width: 14, height: 40 }),
    ),
  );
}

export class CommonParts {
  constructor(mode) {
    const { actions, canvas } = mode;
    let dragged = null;
    const buttons = Object.entries(PARTS).map(([name, words]) => {
      const part = partOf(words);
      const add = (spot) => actions.insert(part, `Add ${name}:`, spot);
      const button = h(
        "button",
        { draggable: "true", title: `${name}: click, or drag it into the drawing` },
        pictureOf(part),
        name,
      );
      button.onclick = () => add(canvas.freeSpot());
      button.ondragstart = ({ dataTransfer }) => {
        dataTransfer.setData("text/plain", name);
        dragged = add;
      };
      button.ondragend = () => (dragged = null);
      return button;
    });
    const frame = $("ed-frame"); // made anew with the mode
    frame.ondragover = (event) => dragged && event.preventDefault();
    frame.ondrop = (event) => {
      if (!dragged) return;
      const { left, top } = canvas.container.getBoundingClientRect();
      event.preventDefault();
      dragged(canvas.toDrawing(event.clientX - left, event.clientY - top));
    };
    $("ed-list-box").after(
      h("details.ed-palette", { open: innerWidth > 999 }, h("summary", "Parts"), h("div", buttons)),
    );
  }
}
