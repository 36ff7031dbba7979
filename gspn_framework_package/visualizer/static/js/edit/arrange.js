// The grid and the guides that a dragged node snaps to, and the alignment and distribution of several nodes.

export const GRID = 10; // px between the lines of the grid
const NEAR = 7; // px within which a node snaps to the line of another node

export const onGrid = (value) => Math.round(value / GRID) * GRID;

/** The nearest value of one of `others` to `wanted`, within `reach`; null if none is that near. */
function nearest(wanted, others, reach) {
  let [best, least] = [null, reach];
  for (const value of others) {
    const apart = Math.abs(value - wanted);
    if (apart < least || (apart === least && best === null)) [best, least] = [value, apart];
  }
  return best;
}

/** Snap a point to the lines of other nodes, or else to the grid. `k`: the zoom. Returns {x, y, guides}: guides are
 * [["x" | "y", value], ...]. */
export function snapped(x, y, others, k) {
  const guides = [];
  const line = (axis, wanted) => {
    const found = nearest(
      wanted,
      others.map((node) => node[axis]),
      NEAR / k,
    );
    if (found === null) return onGrid(wanted);
    guides.push([axis, found]);
    return found;
  };
  return { x: line("x", x), y: line("y", y), guides };
}

/** The ways to arrange several nodes: [word, title]. */
export const ARRANGEMENTS = [
  ["left", "Align left"],
  ["centre", "Align centres"],
  ["right", "Align right"],
  ["top", "Align tops"],
  ["middle", "Align middles"],
  ["bottom", "Align bottoms"],
  ["across", "Distribute horizontally"],
  ["down", "Distribute vertically"],
];

/** New positions of nodes {name, x, y}: name -> [x, y]. */
export function arranged(how, nodes) {
  const result = new Map();
  const spread = (axis) => {
    const sorted = [...nodes].sort((a, b) => a[axis] - b[axis]);
    const [first, last] = [sorted[0][axis], sorted[sorted.length - 1][axis]];
    sorted.forEach((node, i) => {
      const value = first + ((last - first) * i) / Math.max(1, sorted.length - 1);
      result.set(node.name, axis === "x" ? [value, node.y] : [node.x, value]);
    });
  };
  const line = (axis, value) => {
    for (const node of nodes)
      result.set(node.name, axis === "x" ? [value, node.y] : [node.x, value]);
  };
  const [xs, ys] = [nodes.map((node) => node.x), nodes.map((node) => node.y)];
  const mid = (values) => (Math.min(...values) + Math.max(...values)) / 2;
  const act = {
    left: () => line("x", Math.min(...xs)),
    centre: () => line("x", mid(xs)),
    right: () => line("x", Math.max(...xs)),
    top: () => line("y", Math.min(...ys)),
    middle: () => line("y", mid(ys)),
    bottom: () => line("y", Math.max(...ys)),
    across: () => spread("x"),
    down: () => spread("y"),
  }[how];
  act?.();
  return result;
}
