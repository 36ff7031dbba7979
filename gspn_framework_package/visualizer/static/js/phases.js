// The phases of robots: the server provides the word and the flags of each phase (execution/phase.py explains each
// flag).

const UNHEARD = { word: "", tone: "" };

let table = {}; // phase -> {word, tone, and flags}
/** The phases that the page has to name itself: of a robot that has just entered a place (`entered`), is `paused` or
 * `waiting`, or had not finished when the run ended (`stopped`). */
export const named = {};

export function setPhases(phases) {
  table = phases.table;
  Object.assign(named, phases.named);
}

/** The word, the tone and the flags of a phase. */
export const reportOf = (phase) => table[phase] || table[""] || UNHEARD;

/** The same for the phase to show for a robot on a board with this status; in Python, `reported_phase`. */
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
