// The symbols of places and transitions: how each is drawn, what it contains, and how a result is highlighted on it.

import { RADIUS, BAR, dots, discs } from "./geometry.js";
import { natural, s } from "./dom.js";
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

export function buildPlace(node, place) {
  return s(
    "g",
    { class: `place ${place.kind}`, transform: at(node), "data-place": node.index },
    s("title", place.name),
    s("circle", { r: RADIUS }),
  );
}

export function buildTransition(node, transition) {
  const [w, h] = BAR[node.kind];
  return s(
    "g",
    { class: `transition ${node.kind}`, transform: at(node), "data-transition": node.index },
    s("title", transition.name),
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
  node.element.append(node.dots);
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
        return s(
          "g",
          {
            class: `robot ${phase}${robot.paused ? " paused" : ""}`,
            transform: at({ x: centres[i][0], y: centres[i][1] }),
            "data-robot": robot.name,
          },
          s("title", robot.name),
          disc,
          text,
        );
      }),
  );
  node.element.append(node.robots);
}

export function drawEnabled(node, enabled) {
  if (node.enabled === enabled) return;
  node.enabled = enabled;
  node.element.classList.toggle("enabled", enabled);
  if (enabled && !node.flag) {
    node.flag = s("path.flag", { d: `M-6 ${-BAR[node.kind][1] - 11}h12l-6 7z` });
    node.element.append(node.flag);
  }
}

/** Draw the robots that were lost in a place: crossed out, at its edge. */
export function drawLost(node, robots) {
  take(node, "lost");
  if (!robots.length) return;
  node.lost = s(
    "g",
    robots.map((robot, i) =>
      s(
        "g.lost-mark",
        {
          transform: at({ x: RADIUS * 0.8 + i * 17, y: -RADIUS * 0.8 }),
          "data-lost": robot.name,
        },
        s("title", `${robot.name} is lost`),
        s("circle", { r: 8 }),
        s("text", shortName(robot.name)),
        s("path", { d: "M-5.5 5.5L5.5 -5.5" }),
      ),
    ),
  );
  node.element.append(node.lost);
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
    node.element.append(node.value);
  }
}
