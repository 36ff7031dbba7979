// The phases of robots: the server provides the word and the flags of each phase (execution/phase.py explains each
// flag).

const UNHEARD = { word: "", tone: "" };

let table = {}; // phase -> {word, tone, and flags}
/** The phases that the page has to name itself: of a robot that a firing has moved into a place (`entered`), that is
 * `paused`, that is `waiting`, and that had not finished when the run `stopped`. */
export const named = {};

export function setPhases(phases) {
  table = phases.table;
  Object.assign(named, phases.named);
}

/** The word, the tone and the flags of a phase. */
export const reportOf = (phase) => table[phase] || table[""] || UNHEARD;

/** The same for the phase shown for a robot on a board with that status; `reported_phase` in Python. */
export function robotReport(robot, status) {
  const own = reportOf(robot.phase);
  if (own.outlasts) return own;
  if (status.ended) return status.finished && own.at_rest ? own : reportOf(named.stopped);
  return robot.paused ? reportOf(named.paused) : own;
}

/** The phases in which a robot needs the operator, worst first: [[phase, its word, tone and flags], ...]. */
export const alarming = () =>
  Object.entries(table)
    .filter(([, is]) => is.needs_operator)
    .sort(([, a], [, b]) => b.gone - a.gone);
