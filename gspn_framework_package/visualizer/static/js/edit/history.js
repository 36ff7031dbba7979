// The history of a document as JSON, which is stored with its draft: the states of its edits, each as the difference
// from the one after it. A difference is {value}, {keys: {key: difference}}, {items: {index: difference}} or
// {splice: [start, number of items that go, new items]}; null where there is none.

const EDITS = 200; // edits that are stored, in each direction
const LARGEST = 1_000_000; // characters; of a longer history, the earliest edits are left out

const isObject = (value) => typeof value === "object" && value !== null;

/** The changes from `from` to `to`, two states that share unchanged parts. */
function difference(from, to) {
  if (from === to) return null;
  if (!isObject(from) || !isObject(to) || Array.isArray(from) !== Array.isArray(to))
    return { value: to };
  if (!Array.isArray(from)) {
    const names = Object.keys(to);
    if (Object.keys(from).join("\n") !== names.join("\n")) return { value: to };
    return { keys: differences(names, from, to) };
  }
  if (from.length === to.length) return { items: differences([...to.keys()], from, to) };
  const least = Math.min(from.length, to.length);
  let start = 0;
  while (start < least && from[start] === to[start]) start += 1;
  let end = 0;
  while (end < least - start && from[from.length - 1 - end] === to[to.length - 1 - end]) end += 1;
  return { splice: [start, from.length - start - end, to.slice(start, to.length - end)] };
}

const differences = (keys, from, to) =>
  Object.fromEntries(
    keys.filter((key) => from[key] !== to[key]).map((key) => [key, difference(from[key], to[key])]),
  );

/** The state that a difference leads to. */
function applied(from, change) {
  if (change === null) return from;
  if ("value" in change) return change.value;
  if (change.splice) {
    const [start, gone, items] = change.splice;
    return [...from.slice(0, start), ...items, ...from.slice(start + gone)];
  }
  const result = Array.isArray(from) ? [...from] : { ...from };
  for (const [key, inner] of Object.entries(change.keys ?? change.items))
    result[key] = applied(from[key], inner);
  return result;
}

/** Edits with their states as differences; `near` says which of its states is nearer to the present one. */
function packed(edits, state, [near, far]) {
  const found = [];
  let size = 0;
  let last = state;
  for (const edit of edits.slice(-EDITS).reverse()) {
    const item = {
      label: edit.label,
      near: difference(last, edit[near]),
      far: difference(edit[near], edit[far]),
    };
    size += JSON.stringify(item).length;
    if (size > LARGEST) break;
    found.push(item);
    last = edit[far];
  }
  return found;
}

function unpacked(items, state, [near, far]) {
  let last = state;
  const edits = items.map((item) => {
    const first = applied(last, item.near);
    last = applied(first, item.far);
    return { label: item.label, merge: null, [near]: first, [far]: last };
  });
  return edits.reverse();
}

const BACK = ["after", "before"];
const FORTH = ["before", "after"];

/** The history of a document whose present state is `state`. */
export const packedHistory = ({ done, undone }, state) => ({
  done: packed(done, state, BACK),
  undone: packed(undone, state, FORTH),
});

/** The edits of a packed history: {done, undone}. */
export const unpackedHistory = ({ done, undone }, state) => ({
  done: unpacked(done, state, BACK),
  undone: unpacked(undone, state, FORTH),
});
