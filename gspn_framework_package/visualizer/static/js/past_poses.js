// Where the robots were at an earlier time of the run: the server has their poses twice a second.

import { get } from "./api.js";

const GAP = 1; // s; robots that were not reported for longer stood still

export class PastPoses {
  /** @param changed called when poses have arrived. */
  constructor(model, changed) {
    this.model = model;
    this.changed = changed;
    this.known = null; // the stretch that is loaded: epoch, from, to, moments
  }

  /** Robot -> pose at a time (s) of the run; what is known so far, while more is being loaded. */
  at(t) {
    const { known } = this;
    const here = known?.epoch === this.model.epoch ? known : null;
    if (!here || t < here.from || t > here.to) this.load(t);
    const moments = here?.moments || [];
    const i = moments.findLastIndex((moment) => moment.t <= t);
    const [before, after] = [moments[i], moments[i + 1]];
    if (!before || !after || after.t - before.t > GAP) return before?.robots || {};
    return between(before.robots, after.robots, (t - before.t) / (after.t - before.t));
  }

  /** Load the stretch around a time; of several asked for at once, the first and then the last. */
  async load(t) {
    this.wanted = t;
    if (this.loading) return;
    this.loading = true;
    try {
      while (this.wanted !== null) {
        const at = this.wanted;
        this.wanted = null;
        this.known = await get("poses", { id: this.model.session.id, t: at.toFixed(3) });
      }
      this.changed();
    } catch {
      this.known = null; // the next drawing asks again
    } finally {
      this.loading = false;
    }
  }
}

/** The poses a share of the way from some to later ones. */
function between(before, after, share) {
  const mixed = Object.entries(before).map(([name, robot]) => {
    const [from, to] = [robot.pose, (after[name] || robot).pose];
    const mean = from.map(
      (value, i) => value + share * (i < 2 ? to[i] - value : turn(value, to[i])),
    );
    return [name, { ...robot, pose: mean }];
  });
  return Object.fromEntries(mixed);
}

/** The angle between two, the short way round. */
export const turn = (from, to) => Math.atan2(Math.sin(to - from), Math.cos(to - from));
