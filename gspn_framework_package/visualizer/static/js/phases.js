// What robots are up to: the words and the flags of each phase are the server's, which alone knows them
// (execution/phase.py says what each flag means).

const UNHEARD = { word: "", tone: "" };

let table = {}; // phase -> {word, tone, and flags}
/** Phases that the page has to name itself: of a robot that a firing has `entered` into a place, that is `paused`, that
 * is `waiting`, that had not finished when the run `stopped`. */
export const named = {};

export function setPhases(phases) {
  table = phases.table;
  Object.assign(named, phases.named);
}

/** The word, the tone and the flags of a phase. */
export const told = (phase) => table[phase] || table[""] || UNHEARD;

/** The same of what a robot is told to be up to, on a board with that status; Python has it as `told_phase`. */
export function toldOf(robot, status) {
  const own = told(robot.phase);
  if (own.outlasts) return own;
  if (status.ended) return status.finished && own.at_rest ? own : told(named.stopped);
  return robot.paused ? told(named.paused) : own;
}

/** The phases in which a robot needs the operator, the worst first: [[phase, what is told of it], ...]. */
export const alarming = () =>
  Object.entries(table)
    .filter(([, is]) => is.needs_operator)
    .sort(([, a], [, b]) => b.gone - a.gone);
