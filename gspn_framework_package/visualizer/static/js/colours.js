// A colour and a short id for each robot, the same everywhere on the page and for every viewer.

const PALETTE = [
  "#2563b8", "#c2410c", "#15803d", "#9333ab", "#b91c4b", "#0e7490", "#8a6100", "#4f46c4",
  "#5b7a1f", "#a8327d", "#3f6475", "#8c4a2f",
];

const assigned = new Map();

export function forgetRobots() {
  assigned.clear();
}

function hash(text) {
  let value = 7;
  for (const character of text) value = (value * 31 + character.codePointAt(0)) >>> 0;
  return value;
}

/** Colour by the number in the name (robot_1, robot_2 ...: neighbours differ), by hash otherwise. */
export function colourOf(name) {
  let colour = assigned.get(name);
  if (!colour) {
    const digits = /(\d+)$/.exec(name);
    colour = PALETTE[(digits ? Number(digits[1]) - 1 + PALETTE.length : hash(name)) % PALETTE.length];
    assigned.set(name, colour);
  }
  return colour;
}

/** At most three characters: the number at the end of the name, or its first letters. */
export function shortName(name) {
  const digits = /(\d{1,3})$/.exec(name);
  return digits ? digits[1] : name.replace(/[^\p{L}\p{N}]/gu, "").slice(0, 2) || "?";
}
