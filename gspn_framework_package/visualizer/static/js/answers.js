// The answers to the questions of an analysis, in words, tables and plots.

import { assumed, behaviour, cover, decided, reach, structure } from "./net_answers.js";
import { sweepAnswer } from "./sweep.js";
import { passage, settling, simulated, steadyState, transient } from "./time_answers.js";

/** The elements of all answers. `show`: the pieces that they are made of (answer_pieces.js); `request`: what was
 * asked; `body`: what was sent to the server. */
export function answersTo(show, result, request, body) {
  if (request.simulate) return [simulated(show, result.simulation)].filter(Boolean);
  if (request.sweep) return [sweepAnswer(show, result.sweep)].filter(Boolean);
  if (request.decide) return [decided(show, result.decided)];
  const parts = [];
  if (request.reach) parts.push(reach(show, result));
  if (request.cover) parts.push(cover(show, result));
  if (request.mean_time_to) parts.push(passage(show, result));
  if (request.at && !request.mean_time_to) parts.push(transient(show, result));
  if (request.settling !== undefined) parts.push(settling(show, result));
  if (request.structure) parts.push(structure(show, result));
  const particular = ["reach", "cover", "mean_time_to", "at", "settling"];
  if (!particular.some((key) => key in request)) {
    if (result.bounded !== undefined) parts.push(behaviour(show, result, body));
  } else if (body.policy && result.timing?.assumptions.length) {
    parts.push(show.section("Assumed", assumed(result.timing)));
  }
  if (request.timing) parts.push(steadyState(show, result));
  return parts.flat().filter(Boolean);
}
