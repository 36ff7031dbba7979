// What the page shows: the scene (fixed), the board (now), the events that led here.
// The server plays the token game; the page only adds up what it is told.

import { get } from "./api.js";

const KEPT = 20000; // events kept for the log and the time line

export function applyEvent(board, event) {
  board.n = event.n;
  board.t = event.t;
  if (event.k === "fire" || event.k === "undo") {
    for (const [p, change] of event.d) board.marking[p] += change;
    board.counts[event.tr] += event.k === "fire" ? 1 : -1;
    for (const t of event.dis) board.enabled.delete(t);
    for (const t of event.en) board.enabled.add(t);
    for (const [name, , to] of event.m) {
      if (to === null) { board.robots.delete(name); continue; }
      board.robots.set(name, { ...(board.robots.get(name) || { name }), place: to, phase: "doing", why: "", since: event.t });
    }
  } else if (event.k === "mark") {
    board.marking = event.marking.slice();
    board.enabled = new Set(event.enabled);
    if (event.restart) board.counts = board.counts.map(() => 0);
  } else if (event.k === "robots") {
    for (const robot of event.r) {
      const known = { ...(board.robots.get(robot.name) || {}), ...robot };
      const before = board.robots.get(robot.name) || {};
      if (known.place !== before.place || known.phase !== before.phase) known.since = event.t;
      board.robots.set(robot.name, known);
    }
    for (const name of event.gone || []) board.robots.delete(name);
  } else if (event.k === "note") {
    board.notes = [...board.notes.slice(-49), event];
  } else if (event.k === "status") {
    board.status = { ...board.status, ...event.status };
  }
}

export function boardOf(data) {
  return { ...data, enabled: new Set(data.enabled), robots: new Map(data.robots.map((robot) => [robot.name, robot])) };
}

/** Fires: "scene", "reset" (the board is another one), "events" (detail.events were added to the board),
 * "head" (news behind a paused view), "latest" (detail.keys), "view" (following or not). */
export class Model extends EventTarget {
  constructor(session) {
    super();
    this.session = session;
    this.scene = session.scene;
    this.mode = "";
    this.info = {};
    this.epoch = "";
    this.board = null;
    this.head = { n: 0, t: 0, status: {} };
    this.oldest = 0;
    this.events = [];
    this.latest = {};
    this.following = true;
    this.lastEvent = null; // performance.now() of the last event, for its age
    this.lostAt = null; // performance.now() when the server was last heard; null while it is heard
    this.playing = false;
    this.speed = 1;
  }

  tell(type, detail = {}) {
    this.dispatchEvent(new CustomEvent(type, { detail }));
  }

  /** News of the server's hub. */
  take(news) {
    if (news.snapshot) this.restart(news.snapshot);
    if (news.events && news.events.length) this.append(news.events);
    const keys = Object.keys(news.latest || {});
    if (keys.length) {
      Object.assign(this.latest, news.latest);
      if (news.latest.info) this.info = news.latest.info;
      this.tell("latest", { keys });
    }
  }

  restart(snapshot) {
    const another = this.epoch !== snapshot.epoch;
    this.epoch = snapshot.epoch;
    this.mode = snapshot.mode;
    this.info = snapshot.info;
    this.oldest = snapshot.oldest;
    if (another) this.latest = {};
    const board = boardOf(snapshot.board);
    this.head = { n: board.n, t: board.t, status: board.status };
    this.lastEvent = snapshot.age === null ? null : performance.now() - snapshot.age * 1000;
    this.clockBase = performance.now() - (snapshot.clock || 0) * 1000;
    if (!another && !this.following) { this.tell("head"); return; }
    this.events = [];
    this.following = this.mode !== "REPLAY";
    this.playing = false;
    this.board = board;
    this.tell("reset", { another });
    if (this.mode === "REPLAY") this.show(0);
    else this.fetchPast();
  }

  append(events) {
    const last = events[events.length - 1];
    this.head.n = last.n;
    this.head.t = last.t;
    this.lastEvent = performance.now();
    for (const event of events) if (event.k === "status") this.head.status = { ...this.head.status, ...event.status };
    const tail = this.events.length ? this.events[this.events.length - 1].n : this.board.n;
    if (events[0].n === tail + 1) {
      this.events = this.events.concat(events);
      if (this.events.length > KEPT * 1.1) this.events = this.events.slice(-KEPT);
    }
    if (!this.following) { this.tell("head"); return; }
    for (const event of events) applyEvent(this.board, event);
    this.tell("events", { events });
  }

  /** The server is heard, or (with the time at which it was heard last) is not. */
  setHeard(lostAt) {
    if (this.lostAt !== null && lostAt !== null) return;
    this.lostAt = lostAt;
    this.tell("view");
  }

  /** Whether what is shown may have changed long since: nobody tells. A recorded run does not change. */
  get stale() { return this.lostAt !== null && this.mode !== "REPLAY"; }

  /** Seconds of the run that the view shows; a live one goes on between events, while the server is heard. */
  now() {
    if (this.mode === "LIVE" && this.following && this.board.status.running) {
      return Math.max(this.board.t, ((this.lostAt ?? performance.now()) - this.clockBase) / 1000);
    }
    return this.playing ? Math.max(this.board.t, this.playClock || 0) : this.board.t;
  }

  /** The events just before the board, for the log and the time line. */
  async fetchPast() {
    const epoch = this.epoch, before = this.board.n;
    if (!before || (this.events.length && this.events[0].n <= before - 500)) return;
    const data = await get("events", { id: this.session.id, after: Math.max(0, before - 3000), to: before }).catch(() => null);
    if (!data || data.epoch !== epoch || this.epoch !== epoch || !data.events.length) return;
    const last = data.events[data.events.length - 1].n;
    this.events = data.events.concat(this.events.filter((event) => event.n > last));
    this.tell("past");
  }

  // -- looking back --------------------------------------------------------------------------------

  pause() {
    if (!this.following) return;
    this.following = false;
    this.tell("view");
  }

  /** Show the board after event `n`. */
  async show(n) {
    this.following = false;
    this.wanted = n;
    this.tell("view");
    if (this.fetching) return;
    this.fetching = true;
    try {
      while (this.wanted !== null) {
        const at = this.wanted;
        this.wanted = null;
        const data = await get("state", { id: this.session.id, at });
        if (data.epoch !== this.epoch || this.following) return;
        this.board = boardOf(data.board);
        this.tell("reset", { another: false });
        if (this.wanted === null) await this.fetchAround();
      }
    } finally {
      this.fetching = false;
    }
  }

  /** Have the events around the board at hand. */
  async fetchAround() {
    const n = this.board.n;
    const first = this.events.length ? this.events[0].n : Infinity;
    const last = this.events.length ? this.events[this.events.length - 1].n : -1;
    const to = Math.min(this.head.n, n + 2000);
    if (first <= Math.max(this.oldest + 1, n - 500) && last >= Math.min(this.head.n, n + 500)) return;
    const data = await get("events", { id: this.session.id, after: Math.max(0, n - 2000), to });
    if (data.epoch !== this.epoch) return;
    this.events = data.events;
    this.tell("past");
  }

  /** Go on by events that are at hand, up to event `n` or time `t`. */
  forward(n, t = Infinity) {
    const added = [];
    let index = this.indexAfter(this.board.n);
    while (index < this.events.length && this.board.n < n && this.events[index].t <= t) {
      if (this.events[index].n !== this.board.n + 1) break;
      applyEvent(this.board, this.events[index]);
      added.push(this.events[index++]);
    }
    if (added.length) this.tell("events", { events: added });
    return added.length;
  }

  indexAfter(n) {
    let low = 0, high = this.events.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.events[middle].n <= n) low = middle + 1; else high = middle;
    }
    return low;
  }

  /** One firing forward or backward in a view that does not follow. */
  async stepView(direction) {
    this.pause();
    this.playing = false;
    if (direction > 0) {
      const index = this.indexAfter(this.board.n);
      const next = this.events.slice(index).find((event) => event.k === "fire" || event.k === "mark");
      if (next) this.forward(next.n);
      else if (this.board.n < this.head.n) await this.show(Math.min(this.head.n, this.board.n + 1));
      this.tell("view");
      return;
    }
    const before = this.events.slice(0, this.indexAfter(this.board.n)).reverse().find((event) => event.k === "fire");
    await this.show(before ? before.n - 1 : Math.max(this.oldest, this.board.n - 1));
  }

  play() {
    if (this.board.n >= this.head.n) return;
    this.playing = true;
    this.playFrom = performance.now();
    this.playTime = this.board.t;
    this.playClock = this.board.t;
    this.tell("view");
    const tick = () => {
      if (!this.playing || this.following) return;
      this.playClock = this.playTime + ((performance.now() - this.playFrom) / 1000) * this.speed;
      this.forward(Infinity, this.playClock);
      if (this.board.n >= this.head.n) {
        this.playing = false;
        this.tell("view");
        return;
      }
      const last = this.events.length ? this.events[this.events.length - 1].n : 0;
      if (last < this.head.n && last - this.board.n < 500 && !this.loading) {
        this.loading = true;
        this.fetchAround().catch(() => {}).finally(() => { this.loading = false; });
      }
      requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  setSpeed(speed) {
    this.playTime = this.playClock || this.board.t;
    this.playFrom = performance.now();
    this.speed = speed;
  }

  stopPlaying() {
    this.playing = false;
    this.tell("view");
  }

  /** Follow again: by the events at hand if they reach, by a fresh state otherwise. */
  async backToLive() {
    this.playing = false;
    const last = this.events.length ? this.events[this.events.length - 1].n : -1;
    if (last === this.head.n && this.head.n - this.board.n < 200) {
      this.following = true;
      this.forward(this.head.n);
      this.tell("view");
      return;
    }
    const epoch = this.epoch;
    const data = await get("state", { id: this.session.id, at: this.head.n });
    if (data.epoch !== epoch) return;
    const board = boardOf(data.board);
    const at = this.indexAfter(board.n);
    const rest = this.events.slice(at);
    if (board.n < this.head.n && (!rest.length || rest[0].n !== board.n + 1)) return this.backToLive();
    this.board = board;
    for (const event of rest) applyEvent(this.board, event);
    this.following = true;
    this.tell("reset", { another: false });
    this.tell("view");
    this.fetchPast();
    return undefined;
  }
}
