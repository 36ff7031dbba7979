// Shows data, tasks and events; the server sends short texts.

import { h } from "./dom.js";

/** The entries of an object whose keys are names of the plan. */
const entriesOf = (named) => Object.entries(named || {});
const ofName = (named, name) => new Map(entriesOf(named)).get(name);

/** The tasks in a queue (place name), the next one first: [id, data]. */
export const queueOf = (board, place) => ofName(board.data?.queues, place) || [];

/** The ids of the tasks that wait outside to enter by a transition. */
export const waitingFor = (board, transition) =>
  (board.data?.waiting || []).filter(([name]) => name === transition).map(([, id]) => id);

/** Data as lines of name and value. */
export const dataLines = (named) =>
  entriesOf(named).map(([name, value]) => h("div.datum", h("span.name", name), ` ${value}`));

/** A task with its data, and the buttons of orders about it. */
export const taskLine = ([id, data], buttons = []) =>
  h(
    "div.task",
    h("strong", id ? `task ${id}` : "a task without an id"),
    dataLines(data),
    buttons.length > 0 && h("div.buttons", buttons),
  );

/** The task, the held events and the data of a robot; empty if it has none. */
export function robotExtras(robot) {
  return [
    robot.task && taskLine(robot.task),
    ...entriesOf(robot.held).map(([event, cause]) =>
      h("div.held", `holds ${event}${cause ? `: ${cause}` : ""}`),
    ),
    robot.resumed_from > 0 && h("div.muted", `continues visit ${robot.resumed_from}`),
    ...dataLines(robot.data),
  ].filter(Boolean);
}

/** One end of a task's move, in words. */
const end = (name) => name.replace(/^(place|robot) /, "") || "outside";

/** What the log shows for a firing in addition to its moves: its cause and tasks. */
export function firingExtras(event) {
  const tasks = (event.tk || []).map(([id, from, to]) => `task ${id}: ${end(from)} → ${end(to)}`);
  return { cause: event.why ? ` (${event.why})` : "", tasks };
}
