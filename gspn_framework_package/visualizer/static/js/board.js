// The state shown at one moment, and how an event changes it. board.py describes the events and implements the same
// rules; a table of cases and random events verify that the two agree (test_browser_board.py).

import { named } from "./phases.js";

const NOTES_KEPT = 50;
const SINCE = ["place", "phase"]; // a robot's `since` is the time at which one of these last changed

const OF_VISIT = { held: {}, resumed_from: 0 }; // the fields of a robot's visit, with their initial values

/** The entry of a robot that enters a place (index). */
function entered(robot, place) {
  const left = Object.entries(OF_VISIT).filter(([key]) => key in robot);
  return { ...robot, place, phase: named.entered, why: "", ...Object.fromEntries(left) };
}

/** Continue with the net of another plan: surviving elements keep their firings and robots. */
function changePlan(board, event) {
  board.plan = event.plan;
  board.marking = event.marking.slice();
  board.enabled = new Set(event.enabled);
  const counts = new Array(event.size).fill(0);
  event.transitions.forEach((now, before) => {
    if (now !== null) counts[now] += board.counts[before];
  });
  board.counts = counts;
  for (const [name, robot] of board.robots)
    board.robots.set(name, { ...robot, place: event.places[robot.place] ?? -1 });
}

/** Update the board by one event. */
export function applyEvent(board, event) {
  board.n = event.n;
  board.t = event.t;
  if (event.k === "fire" || event.k === "undo") {
    for (const [p, change] of event.d) board.marking[p] += change;
    board.counts[event.tr] += event.k === "fire" ? 1 : -1;
    for (const t of event.en) board.enabled.add(t);
    for (const t of event.dis) board.enabled.delete(t);
    for (const [name, , to] of event.m) {
      if (to === null) {
        board.robots.delete(name);
        continue;
      }
      board.robots.set(name, {
        ...entered(board.robots.get(name) || { name }, to),
        since: event.t,
      });
    }
  } else if (event.k === "mark") {
    board.marking = event.marking.slice();
    board.enabled = new Set(event.enabled);
    if (event.restart) board.counts = board.counts.map(() => 0);
    if (event.counts) board.counts = event.counts.slice();
  } else if (event.k === "plan") {
    changePlan(board, event);
  } else if (event.k === "robots") {
    for (const robot of event.r) {
      const known = board.robots.get(robot.name) || {};
      const moved = SINCE.some((key) => key in robot && robot[key] !== (known[key] ?? null));
      board.robots.set(robot.name, { ...known, ...(moved && { since: event.t }), ...robot });
    }
    for (const name of event.gone || []) board.robots.delete(name);
  } else if (event.k === "data") {
    const { team, waiting, queues } = event;
    if (!team && !waiting && !queues) return;
    board.data = {
      ...board.data,
      ...(team && { team }),
      ...(waiting && { waiting }),
      ...(queues && { queues: { ...board.data?.queues, ...queues } }),
    };
  } else if (event.k === "note") {
    board.notes = [...board.notes.slice(1 - NOTES_KEPT), event];
  } else if (event.k === "status") {
    board.status = { ...board.status, ...event.status };
  }
}

export const copyOf = (board) => ({
  ...board,
  marking: board.marking.slice(),
  counts: board.counts.slice(),
  enabled: new Set(board.enabled),
  robots: new Map(board.robots),
  notes: board.notes.slice(),
});

/** Read a board from its JSON object. */
export function boardOf(data) {
  return {
    ...data,
    enabled: new Set(data.enabled),
    robots: new Map(data.robots.map((robot) => [robot.name, robot])),
  };
}
