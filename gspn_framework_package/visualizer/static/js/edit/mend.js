// Makes the changes that fix a finding, as the check lists them: {label, set: [[path, value],
// ...]}.

import { h } from "../dom.js";

/** A part of a document with the value at `path` replaced. A step into a list is the name of a node; "-" is its end. */
function put(part, [step, ...rest], value) {
  const next = (inner) => (rest.length ? put(inner, rest, value) : value);
  if (Array.isArray(part) || step === "-") {
    const list = part ?? [];
    if (step === "-") return [...list, next(undefined)];
    return list.map((node) => (node.name === step ? next(node) : node));
  }
  return { ...part, [step]: next(part?.[step]) };
}

const POLICY = { places: [], rows: [] };

/** The state of a PlanDocument with a finding fixed. */
function mended(state, { set }) {
  let { plan, net, policy } = state;
  for (const [[first, ...rest], value] of set)
    if (first === "net") net = put(net, rest, value);
    else if (first === "policy") policy = put(policy ?? POLICY, rest, value);
    else plan = put(plan, [first, ...rest], value);
  return { plan, net, policy };
}

/** The button that fixes a finding, as one edit; "" if there is no `mend`. A finding about an
earlier state is not. */ export function mendButton(mode, mend) {
  if (!mend) return "";
  const text = `Fix it: ${mend.label}`;
  const onclick = () => {
    mode.document.edit(text, (state) => mended(state, mend));
    mode.say(`Done: ${mend.label}. Undo takes it back.`);
  };
  return h("button.mend", { text, onclick, disabled: mode.unjudged });
}
