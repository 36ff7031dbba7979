// A colour and a short id for each robot, the same everywhere on the page, for every viewer and in films of the world.
// The server provides the palette; model/robot_colours.py implements the same rule.

let palette = ["#3f6475"];

export function setPalette(colours) {
  if (colours?.length) palette = colours;
}

function hash(text) {
  let value = 7;
  for (const character of text) value = (value * 31 + character.codePointAt(0)) >>> 0;
  return value;
}

/** The colour by the number at the end of the name (robot_1, robot_2 ...: neighbours differ), or by the whole name if
 * it has none. */
export function colourOf(name) {
  const digits = /([0-9]{1,6})$/.exec(name);
  return palette[(digits ? Number(digits[1]) - 1 + palette.length : hash(name)) % palette.length];
}

/** At most three characters: the number at the end of the name, or its first letters. */
export function shortName(name) {
  const digits = /(\d{1,3})$/.exec(name);
  return digits ? digits[1] : name.replace(/[^\p{L}\p{N}]/gu, "").slice(0, 2) || "?";
}
