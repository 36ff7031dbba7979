// The course of a run up to the board that is shown: what the time line draws. It is read from the events at hand; what
// they do not tell is left out.

/** The events since the last reset, without those that were taken back: their times only grow. With `whole`, also those
 * before that reset and earlier ones. */
export function courseOf(model, whole = false) {
  const last = model.indexAfter(model.board.n);
  if (model.mode !== "SIMULATE") return model.events.slice(0, last);
  const course = [];
  let firings = 0, marks = 0; // so many before were taken back
  for (let i = last - 1; i >= 0; i--) {
    const event = model.events[i];
    if (event.k === "undo") firings += 1;
    else if (event.k === "mark" && event.back) marks += 1;
    else if (event.k === "fire" && firings) firings -= 1;
    else if (event.k === "mark" && marks) marks -= 1;
    else {
      course.push(event);
      if (event.restart && !whole) break;
    }
  }
  return course.reverse();
}

/** What each robot did from `begin` to `end` (s): name -> [[from, to, place, phase], ...]. */
export function lanesOf(model, begin, end) {
  const { base, board, events } = model;
  const last = model.indexAfter(board.n);
  const lanes = new Map();
  const enter = (robot, t) => lanes.set(robot.name, { at: t, place: robot.place, phase: robot.phase || "", parts: lanes.get(robot.name)?.parts || [] });
  const leave = (name, t) => {
    const lane = lanes.get(name);
    if (lane && lane.place >= 0 && t > begin && t > lane.at) lane.parts.push([Math.max(begin, lane.at), t, lane.place, lane.phase]);
  };
  const change = (name, t, fields) => {
    const lane = lanes.get(name);
    const robot = { name, place: fields.place ?? lane?.place, phase: fields.phase ?? lane?.phase };
    if (lane && robot.place === lane.place && robot.phase === lane.phase) return;
    leave(name, t);
    enter(robot, t);
  };
  // the events at hand lead from a board that is known to the one that is shown; otherwise only the latter is told
  const told = base && base.n <= board.n && (last > 0 ? events[last - 1].n : base.n) === board.n;
  for (const robot of (told ? base : board).robots.values()) enter(robot, robot.since ?? (told ? base : board).t);
  for (let i = 0; told && i < last; i++) {
    const event = events[i];
    if (event.n <= base.n) continue;
    if (event.k === "fire") {
      for (const [name, , to] of event.m) change(name, event.t, to === null ? { place: -1, phase: "" } : { place: to, phase: "doing" });
    } else if (event.k === "robots") {
      for (const robot of event.r) change(robot.name, event.t, robot);
      for (const name of event.gone || []) change(name, event.t, { place: -1, phase: "" });
    }
  }
  for (const name of lanes.keys()) leave(name, end);
  return new Map([...lanes].filter(([name, lane]) => lane.parts.length || board.robots.has(name)));
}
