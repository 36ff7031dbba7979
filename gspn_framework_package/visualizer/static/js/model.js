// The data that the page shows: the scene (fixed), the board (now), the events that led to it.
// The server plays the token game; the page only applies the server's events.

import { get } from "./api.js";
import { firstWhere } from "./dom.js";
import { applyEvent, boardOf, copyOf } from "./board.js";

const KEPT = 20000; // events kept for the log and the time line
const AHEAD = 5000; // events per request while a recorded run is played
const PREPARED = 3; // s of playback for which events are loaded in advance
const STALL = 250; // largest advance of the playback between two frames, in ms: no jump after the page was hidden

/** Fires: "scene" (another net is shown: the team follows another plan), "reset" (the board was replaced), "events"
 * (detail.events were added to the board), "head" (news behind a paused view), "latest" (detail.keys), "view"
 * (following or not). */
export class Model extends EventTarget {
  constructor(session) {
    super();
    this.session = session;
    this.scenes = new Map([[0, session.scene]]); // number of a plan followed by the run -> its scene
    this.scene = session.scene; // number of the plan of the board shown
    this.arrived = Promise.resolve(); // resolves when all news so far have been processed
    this.waiting = 0; // number of messages waiting for it
    this.mode = "";
    this.info = {};
    this.epoch = "";
    this.board = null; // the board shown
    // the latest board; the same object while following
    this.head = { n: 0, t: 0, status: {}, robots: new Map() };
    this.oldest = 0;
    this.events = []; // consecutive events
    this.base = null; // the board before them; null if unknown
    this.latest = {};
    this.following = true;
    this.lastEvent = null; // performance.now() of the last event, for its age
    this.lostAt = null; // performance.now() of the server's last message; null while connected
    this.playing = false;
    this.speed = 1;
    this.closed = false;
  }

  emit(type, detail = {}) {
    if (!this.closed) this.dispatchEvent(new CustomEvent(type, { detail }));
  }

  /** Stop firing events: the views no longer exist, and pending answers are ignored. */
  close() {
    this.closed = true;
  }

  /** Process the messages of the server's hub in order, each once the net of every plan in it is loaded. */
  take(news) {
    const plans = this.plansIn(news);
    if (!this.waiting && plans.every((plan) => this.scenes.has(plan))) {
      this.takeIn(news);
      return;
    }
    this.waiting += 1;
    this.arrived = this.arrived
      .then(() => this.loadScenes(plans, news.snapshot?.epoch))
      .then(
        () => this.takeIn(news),
        () => this.emit("unread"), // the stream must be reopened
      )
      .finally(() => {
        this.waiting -= 1;
      });
  }

  /** The numbers of the plans that a message refers to. */
  plansIn({ snapshot, events = [] }) {
    if (snapshot && snapshot.epoch !== this.epoch && this.scenes.size > 1)
      this.scenes = new Map([[0, this.session.scene]]); // they belonged to another run
    return [snapshot?.board.plan || 0, ...events.map((event) => event.p || 0)];
  }

  /** Load the scenes of these plans of the run, unless already known. */
  async loadScenes(plans, epoch = this.epoch) {
    for (const plan of new Set(plans)) {
      if (this.scenes.has(plan)) continue;
      const found = await get("scene", { id: this.session.id, plan });
      if (found.epoch !== epoch) throw new Error("another run is shown now");
      this.scenes.set(plan, found.scene);
    }
  }

  /** The scene in which an event happened. */
  sceneOf(event) {
    return this.scenes.get(event.p || 0) || this.scene;
  }

  /** Show the net of the plan that the board follows. */
  showScene() {
    const scene = this.scenes.get(this.board.plan || 0);
    if (scene === this.scene) return;
    this.scene = scene;
    this.emit("scene");
  }

  takeIn(news) {
    if (news.snapshot) this.restart(news.snapshot);
    if (news.head) {
      this.head = news.head;
      this.emit("head");
    } // a recording: how much of it has been read
    if (news.events && news.events.length) this.append(news.events);
    const keys = Object.keys(news.latest || {});
    if (keys.length) {
      Object.assign(this.latest, news.latest);
      if (news.latest.info) this.info = news.latest.info;
      this.emit("latest", { keys });
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
    this.head = board;
    this.lastEvent = snapshot.age === null ? null : performance.now() - snapshot.age * 1000;
    this.clockBase = performance.now() - (snapshot.clock || 0) * 1000;
    if (!another && !this.following) {
      this.emit("head");
      return;
    }
    this.events = [];
    this.base = copyOf(board);
    this.following = this.mode !== "REPLAY";
    this.playing = false;
    this.board = this.following ? board : copyOf(board);
    this.showScene();
    this.emit("reset", { another });
    // if the server does not answer, the connection shows it, and the next reset asks again
    if (this.mode === "REPLAY") this.show(0).catch(() => {});
    else this.fetchPast();
  }

  append(events) {
    this.lastEvent = performance.now();
    if (events[0].n === (this.events.at(-1) ?? this.board).n + 1) {
      this.events = this.events.concat(events);
      this.trim();
    }
    for (const event of events) applyEvent(this.head, event);
    if (this.following) this.tellEvents(events);
    else this.emit("head");
  }

  /** Announce that events were applied to the board shown; under another plan, all of it is redrawn. */
  tellEvents(events) {
    const { scene } = this;
    this.showScene();
    if (scene === this.scene) this.emit("events", { events });
    else this.emit("reset", { another: false });
  }

  /** Record that the server is connected (null), or the time of its last message. */
  setHeard(lostAt) {
    if (this.lostAt !== null && lostAt !== null) return;
    this.lostAt = lostAt;
    this.emit("view");
  }

  /** Whether the state shown may be out of date because the connection is lost. A recorded run does not change. */
  get stale() {
    return this.lostAt !== null && this.mode !== "REPLAY";
  }

  /** Whether nothing is known about a live run yet, so that the board is the plan's initial one. */
  get unheard() {
    return (
      this.mode === "LIVE" && this.head.status.running === false && this.head.status.ended === null
    );
  }

  /** The time of the run shown, in seconds; in a live run it advances between events while the server is connected. */
  now() {
    if (this.mode === "LIVE" && this.following && this.board.status.running) {
      return Math.max(this.board.t, ((this.lostAt ?? performance.now()) - this.clockBase) / 1000);
    }
    return this.playing ? Math.max(this.board.t, this.playClock || 0) : this.board.t;
  }

  /** Load the events just before the board, for the log and the time line. */
  async fetchPast() {
    const before = this.board.n;
    if (!before || (this.events.length && this.events[0].n <= before - 500)) return;
    const found = await this.fetchEvents(Math.max(0, before - 3000), before).catch(() => null);
    if (!found) return;
    const last = found.events[found.events.length - 1].n;
    const events = found.events.concat(this.events.filter((event) => event.n > last));
    if (this.following && events[events.length - 1].n !== this.board.n) return; // another board arrived meanwhile
    this.events = events;
    this.base = found.base;
    this.emit("past");
  }

  /** Load events of this epoch and the board before the first of them; null if there are none. */
  async fetchEvents(after, to) {
    const { epoch } = this;
    const data = await get("events", { id: this.session.id, after, to });
    if (data.epoch !== epoch || this.epoch !== epoch || !data.events.length) return null;
    const before = data.events[0].n - 1;
    const state = await get("state", { id: this.session.id, at: before });
    if (state.epoch !== epoch || this.epoch !== epoch) return null;
    await this.loadScenes([state.board.plan || 0, ...data.events.map((event) => event.p || 0)]);
    if (this.epoch !== epoch) return null;
    return { events: data.events, base: state.board.n === before ? boardOf(state.board) : null };
  }

  /** Drop the oldest events if there are many. */
  trim() {
    const surplus = this.events.length - KEPT;
    if (surplus < KEPT / 10) return;
    if (this.base) for (const event of this.events.slice(0, surplus)) applyEvent(this.base, event);
    this.events = this.events.slice(surplus);
  }

  // -- past states --------------------------------------------------------------------------------

  pause() {
    if (!this.following) return;
    this.letGo();
    this.emit("view");
  }

  /** Stop following the latest board. */
  letGo() {
    if (this.following) this.board = copyOf(this.head);
    this.following = false;
  }

  /** Show the board after event `n`. */
  async show(n) {
    this.letGo();
    this.wanted = n;
    this.emit("view");
    if (this.fetching) return;
    this.fetching = true;
    try {
      while (this.wanted !== null) {
        const at = this.wanted;
        this.wanted = null;
        const data = await get("state", { id: this.session.id, at });
        await this.loadScenes([data.board.plan || 0], data.epoch);
        if (data.epoch !== this.epoch || this.following) return;
        this.board = boardOf(data.board);
        this.showScene();
        this.emit("reset", { another: false });
        if (this.wanted === null) await this.fetchAround();
      }
    } finally {
      this.fetching = false;
    }
  }

  /** Show the board after a slot of the log; false if the log has not been read that far. */
  showSlot(slot) {
    return this.showFound("slot", { slot });
  }

  /** Show the board at a time of the run; false if the log has not been read that far. */
  showTime(t) {
    return this.showFound("moment", { t: t.toFixed(4) });
  }

  async showFound(path, moment) {
    const { epoch, event } = await get(path, { id: this.session.id, ...moment });
    if (event === null || epoch !== this.epoch || this.head.n < event) return false;
    await this.show(event);
    return true;
  }

  /** Load the events around the board. */
  async fetchAround() {
    const n = this.board.n;
    const first = this.events[0]?.n ?? Infinity;
    const last = this.events.at(-1)?.n ?? -1;
    const to = Math.min(this.head.n, n + 2000);
    if (first <= Math.max(this.oldest + 1, n - 500) && last >= Math.min(this.head.n, n + 500))
      return;
    const found = await this.fetchEvents(Math.max(0, n - 2000), to);
    if (!found) return;
    Object.assign(this, found);
    this.emit("past");
  }

  /** Load more events after the loaded ones. */
  async fetchAhead() {
    const { epoch } = this;
    const tail = this.events.at(-1)?.n ?? -1;
    if (tail < this.board.n) return this.fetchAround();
    const current = () => this.epoch === epoch && this.events.at(-1)?.n === tail;
    const data = await get("events", { id: this.session.id, after: tail, to: tail + AHEAD });
    if (data.epoch !== epoch || !current() || data.events[0]?.n !== tail + 1) return undefined;
    const plans = data.events.map((event) => event.p || 0);
    await this.loadScenes(plans, epoch);
    if (!current()) return undefined;
    this.events = this.events.concat(data.events);
    if (this.board.n - this.events[0].n > KEPT / 2) this.trim();
    return undefined;
  }

  /** Advance by loaded events, up to event `n` or time `t`. */
  forward(n, t = Infinity) {
    const added = [];
    let index = this.indexAfter(this.board.n);
    while (index < this.events.length && this.board.n < n && this.events[index].t <= t) {
      if (this.events[index].n !== this.board.n + 1) break;
      applyEvent(this.board, this.events[index]);
      added.push(this.events[index++]);
    }
    if (added.length) this.tellEvents(added);
    return added.length;
  }

  indexAfter(n) {
    return firstWhere(this.events, (event) => event.n > n);
  }

  /** Step one firing forward or backward while the view is paused. */
  async stepView(direction) {
    this.pause();
    this.playing = false;
    if (direction > 0) {
      const index = this.indexAfter(this.board.n);
      const next = this.events
        .slice(index)
        .find(({ k }) => k === "fire" || k === "mark" || k === "plan");
      if (next) this.forward(next.n);
      else if (this.board.n < this.head.n) await this.show(Math.min(this.head.n, this.board.n + 1));
      this.emit("view");
      return;
    }
    const before = this.events
      .slice(0, this.indexAfter(this.board.n))
      .reverse()
      .find((event) => event.k === "fire");
    await this.show(before ? before.n - 1 : Math.max(this.oldest, this.board.n - 1));
  }

  play() {
    if (this.board.n >= this.head.n) return;
    this.playing = true;
    this.playClock = this.board.t;
    this.emit("view");
    let before = performance.now();
    const tick = () => {
      if (!this.playing || this.following) return;
      const now = performance.now();
      const clock = this.playClock + (Math.min(now - before, STALL) / 1000) * this.speed;
      before = now;
      // never beyond the loaded events: the next ones are not known yet
      const tail = this.events.at(-1);
      const known =
        this.events[this.indexAfter(this.board.n)]?.n === this.board.n + 1 ? tail : null;
      this.playClock = Math.max(
        this.playClock,
        known?.n >= this.head.n ? clock : Math.min(clock, known ? known.t : this.board.t),
      );
      this.forward(Infinity, this.playClock);
      if (this.board.n >= this.head.n && !this.info.loading) {
        this.playing = false;
        this.emit("view");
        return;
      }
      const short =
        !known ||
        (known.n < this.head.n &&
          known.n - this.board.n < KEPT / 2 &&
          known.t - this.playClock < PREPARED * this.speed);
      if (short && !this.loading && this.board.n < this.head.n) {
        this.loading = true;
        this.fetchAhead()
          .catch(() => {})
          .finally(() => {
            this.loading = false;
          });
      }
      requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  stopPlaying() {
    this.playing = false;
    this.emit("view");
  }

  /** Follow again: by the loaded events if they suffice, otherwise in one jump. */
  backToLive() {
    this.playing = false;
    this.following = true;
    const last = this.events.at(-1)?.n ?? -1;
    if (last === this.head.n && this.head.n - this.board.n < 200) {
      this.forward(this.head.n);
    } else if (last !== this.head.n) {
      // they belong to another period
      this.events = [];
      this.base = copyOf(this.head);
    }
    const shown = this.board.n;
    this.board = this.head;
    this.showScene();
    if (shown !== this.head.n) this.emit("reset", { another: false });
    this.emit("view");
    this.fetchPast();
  }
}
