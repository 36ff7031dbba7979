// The symbols of places and transitions: how each is drawn, what it contains, and how a result is highlighted on it.

import { RADIUS, BAR, dots, discs } from "./geometry.js";
import { natural, s } from "./dom.js";
import { boundsOf } from "./arc_routes.js";
import { colourOf, shortName } from "./colours.js";
import { named, reportOf } from "./phases.js";

const MOST = 9; // largest number of tokens or robots that are drawn individually

// one path for all tokens of a place
const DOTS = Array.from({ length: MOST + 1 }, (_, count) =>
  dots(count)
    .map(([x, y]) => {
      const r = count === 1 ? 5 : 3.4;
      return `M${(x - r).toFixed(2)} ${y.toFixed(2)}a${r} ${r} 0 1 0 ${2 * r} 0a${r} ${r} 0 1 0 ${-2 * r} 0z`;
    })
    .join(""),
);

export const at = ({ x, y }) => `translate(${x.toFixed(1)} ${y.toFixed(1)})`;

const SPOTS = { circle: ["cx", "cy"], rect: ["x", "y"], text: ["x", "y"] };

/** Move a part of a symbol, and what is in it. A large net with a transform for each part takes a multiple of the time
 * to draw. */
function shift(part, [dx, dy]) {
  SPOTS[part.localName]?.forEach((name, i) => {
    part.setAttribute(name, (Number(part.getAttribute(name)) + [dx, dy][i]).toFixed(2));
  });
  if (part.localName === "path") {
    const moved = (_, x, y) => `M${(Number(x) + dx).toFixed(2)} ${(Number(y) + dy).toFixed(2)}`;
    part.setAttribute("d", part.getAttribute("d").replace(/M(-?[\d.]+) (-?[\d.]+)/g, moved));
  }
  for (const inside of part.children) shift(inside, [dx, dy]);
  return part;
}

/** Add a part to the symbol of a node, drawn around (0, 0) or around [x, y]. */
export function put(node, part, [x, y] = [0, 0]) {
  node.element.append(shift(part, [node.base[0] + x, node.base[1] + y]));
  return part;
}

/** Show a symbol where its node is now, for as long as the node moves. */
export function follow(node) {
  const [x, y] = [node.x - node.base[0], node.y - node.base[1]];
  node.element.setAttribute("transform", at({ x, y }));
}

/** Draw a symbol where its node is now. */
export function settle(node) {
  const way = [node.x - node.base[0], node.y - node.base[1]];
  node.base = [node.x, node.y];
  node.element.removeAttribute("transform");
  if (way[0] || way[1]) for (const part of node.element.children) shift(part, way);
}

const [BESIDE, OVER] = [40, 56]; // px from nodes to the box around them: at its sides, and at the top with its title
const [FURTHER, HIGHER] = [8, 20]; // px that it is larger for each level of boxes inside it
const WIDE = 8; // px of a character of its title

/** The bounds of the box around nodes: [left, top, right, bottom]. `level`: how deeply boxes inside it are nested. */
export function boxOf(nodes, title, level = 0) {
  const bounds = boundsOf(nodes, [], BESIDE + FURTHER * level, OVER + HIGHER * level);
  const [left, top, right, bottom] = bounds;
  return [left, top, Math.max(right, left + 24 + WIDE * title.length), bottom];
}

/** The boxes around nodes, with their titles: [[title, list of nodes], ...]. */
export function boxesAround(list) {
  const drawn = []; // {members, level, element}, the smallest first
  for (const [title, members] of [...list].sort((a, b) => a[1].length - b[1].length)) {
    const nodes = new Set(members);
    const inside = drawn.filter((box) => box.members.every((node) => nodes.has(node)));
    const level = Math.max(0, ...inside.map((box) => box.level + 1));
    const [x, y, right, bottom] = boxOf(members, title, level);
    const box = { x, y, width: right - x, height: bottom - y, rx: 12 };
    const text = s("text", { x: x + 12, y: y + 8 }, title);
    drawn.push({
      members,
      level,
      element: s("g.box", { "data-box": title }, s("rect", box), text),
    });
  }
  return drawn.reverse().map(({ element }) => element);
}

/** Make the symbol of a node where it is: `node.base` is where it is drawn. */
function build(node, attributes, name, ...parts) {
  node.base = [node.x, node.y];
  node.element = s("g", attributes, s("title", name));
  for (const part of parts) if (part) put(node, part);
}

export function buildPlace(node, { name, kind }) {
  const box = { x: -27, y: -27, width: 54, height: 54, rx: 7 };
  build(
    node,
    { class: `place ${kind}`, "data-place": node.index },
    name,
    kind === "subnet-box" && s("rect.box", box),
    s("circle", { r: RADIUS }),
  );
}

export function buildTransition(node, { name }) {
  const [w, h] = BAR[node.kind];
  build(
    node,
    { class: `transition ${node.kind}`, "data-transition": node.index },
    name,
    node.kind === "immediate" && s("rect.hit", { x: -12, y: -h, width: 24, height: 2 * h }),
    s("rect.body", { x: -w, y: -h, width: 2 * w, height: 2 * h, rx: 1 }),
  );
}

/** Take a part of a symbol away, if it has it. */
function take(node, part) {
  node[part]?.remove();
  node[part] = null;
}

/** Draw a place with the given number of tokens, some of which may be robots. */
export function drawPlace(node, tokens, robots) {
  const count = Math.max(0, tokens);
  if (robots.length && robots.length >= count && robots.length <= MOST) {
    drawDots(node, 0, true);
    drawRobots(node, robots);
  } else {
    if (node.robots) drawRobots(node, []);
    drawDots(node, count);
  }
}

function drawDots(node, count, robotsHere = false) {
  if (node.count === count) return;
  if (node.count > 0 !== count > 0)
    node.element.classList.toggle("marked", count > 0 || robotsHere);
  node.count = count;
  take(node, "dots");
  if (count === 0) return;
  node.dots =
    count <= MOST
      ? s("path.dots", { d: DOTS[count], "data-count": count })
      : s("text.count", count < 100000 ? String(count) : "99999+");
  if (count > 999) node.dots.style.fontSize = count > 9999 ? "10px" : "12px";
  put(node, node.dots);
}

function drawRobots(node, robots) {
  take(node, "robots");
  if (!robots.length) return;
  const { radius, centres, square } = discs(robots.length);
  node.robots = s(
    "g",
    robots
      .sort((a, b) => natural(a.name, b.name))
      .map((robot, i) => {
        const phase =
          robot.why && !reportOf(robot.phase).failed ? named.waiting : robot.phase || "";
        const id = shortName(robot.name);
        const text = s("text", id);
        const [high, wide] = square ? [1.5, 3] : [1.15, 2.6];
        const fontSize = radius * Math.min(high, wide / Math.max(1, id.length));
        text.style.fontSize = `${fontSize.toFixed(1)}px`;
        const disc = square
          ? s("rect.disc", {
              x: -radius,
              y: -radius,
              width: 2 * radius,
              height: 2 * radius,
              rx: 3.5,
            })
          : s("circle.disc", { r: radius });
        disc.style.fill = colourOf(robot.name);
        const look = {
          class: `robot ${phase}${robot.paused ? " paused" : ""}`,
          "data-robot": robot.name,
        };
        return shift(s("g", look, s("title", robot.name), disc, text), centres[i]);
      }),
  );
  put(node, node.robots);
}

export function drawEnabled(node, enabled) {
  if (node.enabled === enabled) return;
  node.enabled = enabled;
  node.element.classList.toggle("enabled", enabled);
  if (enabled && !node.flag) {
    node.flag = s("path.flag", { d: `M-6 ${-BAR[node.kind][1] - 11}h12l-6 7z` });
    put(node, node.flag);
  }
}

/** Draw the robots that were lost in a place: crossed out, at its edge. */
export function drawLost(node, robots) {
  take(node, "lost");
  if (!robots.length) return;
  node.lost = s(
    "g",
    robots.map((robot, i) =>
      shift(
        s(
          "g.lost-mark",
          { "data-lost": robot.name },
          s("title", `${robot.name} is lost`),
          s("circle", { r: 8 }),
          s("text", shortName(robot.name)),
          s("path", { d: "M-5.5 5.5l11 -11" }),
        ),
        [RADIUS * 0.8 + i * 17, -RADIUS * 0.8],
      ),
    ),
  );
  put(node, node.lost);
}

const MARKS = ["bad", "good", "mark", "best", "present", "both"];

/** Show the mark and text of a result; null removes both. `wanted.kind`: one of MARKS, or heat with a level from
 * 0 to 1. */
export function paintNode(node, wanted) {
  node.element.classList.remove(...MARKS.map((kind) => `paint-${kind}`));
  const body = node.element.querySelector(node.kind === "place" ? "circle" : "rect.body");
  body.style.fill = "";
  take(node, "value");
  if (!wanted) return;
  if (wanted.kind === "heat") {
    body.style.fill = `color-mix(in srgb, var(--accent) ${Math.round(8 + 62 * wanted.level)}%, var(--sheet))`;
  } else {
    node.element.classList.add(`paint-${wanted.kind}`);
  }
  if (wanted.text) {
    node.value = s("text.value", {
      y: -(node.kind === "place" ? RADIUS : BAR[node.kind][1] + 11) - 6,
      text: wanted.text,
    });
    put(node, node.value);
  }
}
