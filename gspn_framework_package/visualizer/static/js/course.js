// The course of a run up to the board shown, for the time line. It is derived from the loaded events and shows nothing
// that they do not contain.

import { named, reportOf } from "./phases.js";

const NOWHERE = "";

/** The events since the last reset, without those that were undone: their times never decrease. With `whole`, also
 * those before that reset and earlier ones. */
export function courseOf(model, whole = false) {
  const last = model.indexAfter(model.board.n);
  if (model.mode !== "SIMULATE") return model.events.slice(0, last);
  const course = [];
  let firings = 0,
    marks = 0; // that many earlier ones were undone
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

/** The name of a place (index) in a scene; undefined if there is none. */
const nameOf = (scene, place) =>
  place === undefined ? undefined : (scene.places[place]?.name ?? NOWHERE);

/** What each robot did from `begin` to `end` (s): name -> [[from, to, place, phase], ...]; places by name, since the
 * team may have changed its net. */
export function lanesOf(model, begin, end) {
  const { base, board, events } = model;
  const last = model.indexAfter(board.n);
  const lanes = new Map();
  const leave = (lane, t) => {
    const phase = lane.paused ? named.paused : lane.phase; // without one, the robot's state is unknown
    if (phase && reportOf(phase).shown && lane.place && t > begin && t > lane.at)
      lane.parts.push([Math.max(begin, lane.at), t, lane.place, phase]);
  };
  const change = (name, t, place, phase, paused) => {
    let lane = lanes.get(name);
    if (!lane)
      lanes.set(name, (lane = { at: t, place: undefined, phase: "", paused: false, parts: [] }));
    if (
      (place ?? lane.place) === lane.place &&
      (phase ?? lane.phase) === lane.phase &&
      (paused ?? lane.paused) === lane.paused
    )
      return;
    leave(lane, t);
    lane.at = t;
    lane.place = place ?? lane.place;
    lane.phase = phase ?? lane.phase;
    lane.paused = paused ?? lane.paused;
  };
  // whether the loaded events lead from a known board to the one shown; if not, only the latter is known
  const known = base && base.n <= board.n && (last > 0 ? events[last - 1].n : base.n) === board.n;
  let scene = model.scenes.get((known ? base : board).plan || 0) || model.scene;
  for (const robot of (known ? base : board).robots.values())
    change(
      robot.name,
      robot.since ?? (known ? base : board).t,
      nameOf(scene, robot.place),
      robot.phase,
      robot.paused,
    );
  for (let i = 0; known && i < last; i++) {
    const event = events[i];
    if (event.n <= base.n) continue;
    const before = scene;
    scene = model.sceneOf(event);
    if (event.k === "plan") {
      for (const [name, lane] of lanes) {
        const place = before.places.findIndex((one) => one.name === lane.place);
        change(name, event.t, nameOf(scene, event.places[place] ?? -1));
      }
    } else if (event.k === "fire") {
      for (const move of event.m)
        change(move[0], event.t, nameOf(scene, move[2]), move[2] === null ? "" : named.entered);
    } else if (event.k === "robots") {
      for (const robot of event.r)
        change(robot.name, event.t, nameOf(scene, robot.place), robot.phase, robot.paused);
      for (const name of event.gone || []) change(name, event.t, NOWHERE, "");
    }
  }
  for (const lane of lanes.values()) leave(lane, end);
  return new Map([...lanes].filter(([name, lane]) => lane.parts.length || board.robots.has(name)));
}
