// The page: opens a net, follows its hub, and keeps all views on the same board.

import { $, h, ask, cancelOr, attempt, announce, clock, nextTab } from "./dom.js";
import { get, post, NewsStream } from "./api.js";
import { Model } from "./model.js";
import { NetView } from "./net_view.js";
import { NodeList } from "./list.js";
import { Inspector } from "./inspector.js";
import { RobotsPanel } from "./robots_panel.js";
import { AnalysisPanel } from "./analysis_panel.js";
import { OptimisePanel } from "./optimise_panel.js";
import { goToMoment, linkMoment } from "./moment.js";
import { StoryPanel } from "./story_panel.js";
import { FiringLog } from "./log.js";
import { TimeLine } from "./timeline.js";
import { Tools, simulationStage } from "./tools.js";
import { Room } from "./room.js";
import { TABS, bindKeys, showHelp } from "./keys.js";
import { Panels } from "./panels.js";
import { openingScreen, hideOpening } from "./opening.js";
import { login } from "./login.js";
import { HISTORY, hideHistory, showHistory } from "./fleet_history.js";
import { setPalette } from "./colours.js";
import { Alarms } from "./alarms.js";
import { Connection } from "./connection.js";
import { setPhases } from "./phases.js";
import { closeNotice } from "./notice.js";
import { Orders, ONLY_LOOK } from "./orders.js";
import { Editor } from "./edit/editor.js";

const MODE_SAYS = {
  LIVE: "happening now",
  REPLAY: "a recorded run",
  SIMULATE: "the token game; nothing moves in the world",
};

/** The views that show the scene of the model. */
const VIEWS = "view list inspector robots analysis optimise story log line".split(" ");

class Page {
  constructor() {
    this.showEnabled = true;
    this.selection = null;
    this.theme(localStorage.getItem("gspn-theme"));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () =>
      this.theme(localStorage.getItem("gspn-theme")),
    );
    this.panels = new Panels(() => this.room?.shown && this.room.update());
    this.editor = new Editor(this);
    this.connection = new Connection(this);
    this.alarms = new Alarms((tab) => this.showTab(tab));
    this.bind();
    bindKeys(this);
  }

  // -- opening -------------------------------------------------------------------------------------

  async boot() {
    await login();
    this.hello = await attempt(() => get("hello"));
    if (!this.hello) {
      $("connection").dataset.state = "lost";
      $("connection").querySelector("span").textContent = "the server does not answer";
      setTimeout(() => this.boot(), 2000);
      return;
    }
    setPalette(this.hello.robot_colours);
    setPhases(this.hello.phases);
    addEventListener("hashchange", () => this.route());
    await this.route();
  }

  /** The part of the address after # is the key of the open net. */
  async route() {
    const [coded, word] = location.hash.slice(1).split("&");
    const key = decodeURIComponent(coded);
    const edits = word === "edit";
    if (edits && this.editor.id === key) return;
    if (!edits) {
      if (key && this.model?.session.id === key) {
        goToMoment(this, word);
        return;
      }
      if (!(await this.editor.leave())) return;
    }
    hideHistory();
    if (key && edits) await this.editor.open(key);
    else if (key === HISTORY && this.hello.history) this.openHistory();
    else if (key) {
      await this.open(key);
      goToMoment(this, word);
    } else if (this.hello.first && !this.begun) {
      history.replaceState(null, "", `#${encodeURIComponent(this.hello.first)}`);
      await this.open(this.hello.first);
    } else await this.openScreen();
    this.begun = true;
  }

  go(key, word = "") {
    const hash = `#${encodeURIComponent(key)}${word}`;
    if (location.hash === hash) this.route();
    else location.hash = hash;
  }

  /** Show the run net of the open plan. */
  async showRunNet() {
    const opened = await attempt(() => post("run_net", {}, { id: this.model.session.id }));
    if (opened) this.go(opened.id);
  }

  /** Edit a file of the folder. */
  edit(key) {
    this.go(key, "&edit");
  }

  /** The screen for opening a net. `another`: the user asked for it and can return from it. */
  async openScreen(another = false) {
    if (!(await this.editor.leave())) return;
    hideHistory();
    this.showNoNet("No net is open", "GSPN");
    history[another && location.hash ? "pushState" : "replaceState"](null, "", location.pathname);
    const { id, edit } = await openingScreen(this.hello);
    hideOpening();
    if (edit) this.edit(id);
    else this.go(id);
  }

  /** Show the history of the fleet whose store is served. */
  openHistory() {
    hideOpening();
    this.showNoNet("History of the fleet", "History · GSPN");
    showHistory();
  }

  showNoNet(title, ofPage) {
    this.closeNet();
    document.body.dataset.mode = "";
    for (const id of ["mode", "subtitle"]) $(id).textContent = "";
    $("title").textContent = title;
    document.title = ofPage;
  }

  async open(key) {
    hideOpening();
    const session = await attempt(() => get("session", { id: key }));
    if (!session) {
      await this.openScreen();
      return;
    }
    this.closeNet();
    $("page").hidden = $("folds").hidden = false;
    const model = (this.model = new Model(session));
    window.gspn = { page: this, model };
    $("title").textContent = session.scene.name;
    $("title").title = session.title;
    $("subtitle").textContent = session.title === session.scene.name ? "" : session.title;
    document.title = `${session.scene.name} · GSPN`;
    this.openedAt = performance.now();
    this.orders = new Orders(this);
    this.room = new Room(model);
    this.room.addEventListener("place", ({ detail }) => this.fly({ kind: "place", index: detail }));
    this.room.addEventListener("robot", ({ detail }) => {
      const index = model.board.robots.get(detail)?.place ?? -1;
      if (index >= 0) this.fly({ kind: "place", index });
    });
    this.tools = null;
    this.makeViews();
    this.wire(model);
    this.editor.showButtons();
    this.stream = new NewsStream(
      key,
      (news) => this.connection.take(news),
      (state, heard, why) => this.connection.change(state, heard, why),
    );
    const cut = this.connection.cutOff(this.hello, key);
    if (cut) this.connection.tellCut("The last run of this plan was cut off.", cut);
  }

  /** Build the views of the model's scene. */
  makeViews() {
    const { model } = this;
    this.view = new NetView($("net"), model, $("subnets"));
    this.view.setShowEnabled(this.showEnabled);
    this.list = new NodeList(model);
    this.inspector = new Inspector(model, this.orders, this.mayAct);
    this.robots = new RobotsPanel(model, this.orders);
    this.analysis = new AnalysisPanel(
      model,
      this.view,
      (start) => simulationStage(this, start),
      this.mayAct ? "" : ONLY_LOOK,
    );
    this.optimise = new OptimisePanel(model, this.view, this.mayAct ? "" : ONLY_LOOK);
    this.story = new StoryPanel(model);
    this.log = new FiringLog(model);
    this.line = new TimeLine(model);
    this.wireViews();
  }

  closeViews() {
    for (const name of VIEWS) {
      this[name]?.close();
      this[name] = null;
    }
  }

  /** The team follows another plan: show its net, and keep the same node selected if it still exists. */
  showScene() {
    const { model, selection } = this;
    const before = this.view.scene;
    const nodes = (scene, kind) => (kind === "place" ? scene.places : scene.transitions);
    const name = selection && nodes(before, selection.kind)[selection.index].name;
    const { now, fitted } = this.view.camera;
    const camera = before.hash === model.scene.hash && !fitted ? now : null;
    const tab = TABS.find((one) => !$(one).hidden);
    this.closeViews();
    this.makeViews();
    if (camera) this.view.camera.set(camera.k, camera.x, camera.y);
    $("title").textContent = model.scene.name;
    document.title = `${model.scene.name} · GSPN`;
    const index = selection
      ? nodes(model.scene, selection.kind).findIndex((node) => node.name === name)
      : -1;
    this.selection = index < 0 ? null : { kind: selection.kind, index };
    for (const part of [this.view, this.list, this.inspector]) part.select(this.selection);
    this.openTab(tab);
    announce(`The team now follows the plan ${model.scene.name}`);
  }

  closeNet() {
    delete document.body.dataset.ready;
    this.stream?.close();
    this.tools?.stopRunning();
    this.model?.close();
    this.closeViews();
    this.stream = this.model = this.tools = null;
    this.selection = null;
    this.paused = false;
    delete document.body.dataset.stale;
    delete document.body.dataset.fault;
    this.connection.ranBefore = null;
    closeNotice();
    this.alarms.clear();
    $("legend").hidden = true;
    $("room").hidden = true;
    $("execution").hidden = true;
    $("page").hidden = $("folds").hidden = true;
    this.editor.showButtons();
  }

  // -- one board, many views -----------------------------------------------------------------------

  /** Mark the places and transitions with a breakpoint. */
  showBreakpoints() {
    const names = new Set(this.orders.breakpoints);
    const { places, transitions } = this.model.scene;
    for (const element of document.querySelectorAll("#net .place, #net .transition")) {
      const { place, transition } = element.dataset;
      const node = place === undefined ? transitions[transition] : places[place];
      element.classList.toggle("breaks", names.has(node?.name));
    }
  }

  wire(model) {
    model.addEventListener("scene", () => this.showScene());
    model.addEventListener("unread", () => this.stream?.again());
    model.addEventListener("reset", ({ detail }) => {
      if (detail.another) {
        this.showMode();
        if (!this.tools) this.tools = new Tools(this);
        this.tools.refresh();
      }
      this.view.reset();
      for (const part of [this.list, this.inspector, this.log]) part.update();
      this.robots.update();
      if (this.room.shown) this.room.later();
      this.optimise.later();
      this.line.later();
      this.showBreakpoints();
      this.showRun();
    });
    model.addEventListener("events", ({ detail }) => {
      this.view.show(detail.events);
      const { list, inspector, robots, optimise, log, line } = this;
      for (const part of [list, inspector, robots, optimise, log, line]) part.later();
      if (detail.events.some((event) => event.k !== "fire")) this.showRun();
      if (model.mode === "SIMULATE") this.sayFiring(detail.events);
    });
    model.addEventListener("head", () => {
      this.line.later();
      this.showRun();
    });
    model.addEventListener("past", () => {
      this.log.update();
      this.line.later();
    });
    model.addEventListener("latest", ({ detail }) => {
      if (detail.keys.includes("info")) {
        this.tools?.refresh();
        this.inspector.later();
        this.showBreakpoints();
        this.showRun();
      }
      if (detail.keys.includes("choices")) this.inspector.later();
      if (detail.keys.includes("feedback")) {
        this.robots.later();
        this.inspector.later();
      }
      if (detail.keys.includes("model")) {
        this.robots.later();
        this.showRun();
      }
      if (detail.keys.includes("room") || detail.keys.includes("world")) {
        if (this.room.news()) this.tools?.build();
      }
    });
    model.addEventListener("view", () => {
      if (this.room.shown) this.room.later();
      this.tools?.refresh();
      this.line.later();
      this.showRun();
      this.connection.show();
    });
  }

  wireViews() {
    const { model } = this;
    this.view.addEventListener("frame", () => {
      if (!this.model?.board || document.body.dataset.ready) return;
      this.readyAt = performance.now();
      document.body.dataset.ready = (this.readyAt - this.openedAt).toFixed(1);
    });
    this.view.addEventListener("select", ({ detail }) => {
      this.choose(detail);
      if (detail && this.panels.form !== "wide") this.panels.open("right");
    });
    this.view.addEventListener("activate", ({ detail }) => {
      if (detail.kind === "transition" && model.mode === "SIMULATE") this.tools.fire(detail.index);
    });
    const chosen = ({ detail }) => (detail.fly ? this.fly(detail) : this.choose(detail));
    for (const part of [this.list, this.inspector, this.analysis, this.optimise])
      part.addEventListener("choose", chosen);
    this.story.addEventListener("light", ({ detail }) => {
      const index = model.scene.places.findIndex(({ name }) => name === detail);
      const place = index < 0 ? null : { kind: "place", index };
      for (const part of [this.view, this.list, this.room]) part.select(place);
      if (place) this.view.flyTo("place", index);
    });
    this.optimise.addEventListener("saved", async ({ detail }) => {
      this.hello = (await get("hello").catch(() => null)) || this.hello;
      if (detail.open)
        await attempt(async () => this.go((await post("open", { path: detail.path })).id));
    });
    const fire = ({ detail }) => model.mode === "SIMULATE" && this.tools.fire(detail);
    this.list.addEventListener("fire", fire);
    this.inspector.addEventListener("fire", fire);
    this.inspector.addEventListener("run-net", () => this.showRunNet());
    this.inspector.addEventListener("probability", ({ detail }) =>
      this.tools.setProbability(detail.index, detail.value),
    );
    for (const part of [this.log, this.line])
      part.addEventListener("visit", ({ detail }) => attempt(() => model.show(detail)));
  }

  sayFiring(events) {
    const last = [...events].reverse().find((event) => event.k === "fire");
    if (!last) return;
    const many = events.length > 1 ? `${events.length} events, the last: ` : "";
    const { name } = this.model.scene.transitions[last.tr];
    announce(`${many}${name} fired; ${this.model.board.enabled.size} enabled`);
  }

  choose(selection) {
    if (!this.model) return;
    this.selection = selection ? { kind: selection.kind, index: selection.index } : null;
    this.view.select(this.selection);
    this.list.select(this.selection);
    this.inspector.select(this.selection);
    this.room.select(this.selection);
    if (this.selection) this.openTab("inspector");
  }

  /** Choose a node that was found elsewhere, and show it. */
  fly(selection) {
    this.choose(selection);
    this.view.flyTo(selection.kind, selection.index);
  }

  setShowEnabled(on) {
    this.showEnabled = on;
    this.view?.setShowEnabled(on);
    this.tools?.refresh();
  }

  /** Whether this viewer may give orders, or is read-only. */
  get mayAct() {
    return this.hello?.role !== "viewer";
  }

  togglePause() {
    const { model } = this;
    if (model.mode === "SIMULATE" && model.following) {
      this.tools.toggleRunning();
      return;
    }
    if (model.following) model.pause();
    else if (model.playing) model.stopPlaying();
    else if (model.board.n >= model.head.n && model.mode === "REPLAY")
      attempt(async () => {
        await model.show(0);
        model.play();
      });
    else if (model.mode !== "REPLAY" && model.board.n >= model.head.n)
      attempt(() => model.backToLive());
    else model.play();
  }

  /** Open a tab, even if the details are folded. */
  showTab(name) {
    this.panels.open("right");
    this.openTab(name);
  }

  openTab(name) {
    for (const tab of TABS) {
      const on = tab === name;
      $(`tab-${tab}`).setAttribute("aria-selected", on);
      $(`tab-${tab}`).tabIndex = on ? 0 : -1;
      $(tab).hidden = !on;
    }
    if (name === "robots") this.robots?.update();
    if (name === "optimise") this.optimise?.open();
    if (name === "story") this.story?.open();
  }

  // -- around the net ------------------------------------------------------------------------------

  showMode() {
    const { mode, info } = this.model;
    document.body.dataset.mode = mode;
    $("mode").textContent = mode;
    const says = info.says || MODE_SAYS[mode] || "";
    announce(`${mode}: ${says}`);
    this.connection.show();
    const runs = mode !== "SIMULATE" && this.model.scene.plan;
    this.openTab(runs ? "robots" : TABS.find((one) => !$(one).hidden));
  }

  showRun() {
    const { model } = this;
    if (!model.board) return;
    const { status } = model.mode === "REPLAY" ? model.board : model.head;
    document.body.toggleAttribute("data-stale", model.stale || model.unheard);
    document.body.toggleAttribute("data-fault", Boolean(model.mode === "LIVE" && status.fault));
    let says = model.info.says || MODE_SAYS[model.mode] || "";
    if (model.mode === "LIVE" && status.ended)
      says = `${status.fault ? "failed" : "over"}: ${status.ended}`;
    if (model.unheard)
      says =
        "no robot of the team has been heard from yet; this is the initial marking of the plan";
    if (model.info.loading) says += ", still being read";
    if (model.stale) says = `as of ${clock(this.connection.lostSince)}; no contact since`;
    $("frame-name").replaceChildren(h("b", model.mode), says ? ` — ${says}` : "");
    this.showOrders(status);
    this.alarms.show(model, status);
  }

  /** Show what can be started, stopped and ordered now, or why nothing can. */
  showOrders(status) {
    const { model, orders } = this;
    const { session, mode } = model;
    const running = Boolean(status.running);
    $("execution").hidden = !(session.executable || orders.offers("stop"));
    $("start").hidden = !session.executable || running;
    $("start").textContent = mode === "LIVE" ? "Start again" : "Start execution";
    $("to-simulate").hidden = mode !== "LIVE" || running || !session.simulable;
    $("stop").hidden = !running || !orders.offers("stop");
    $("pause-team").hidden = !running || !orders.offers("pause");
    $("pause-team").textContent = status.paused ? "Resume the team" : "Pause the team";
    $("stop-actions").hidden = $("pause-team").hidden;
    for (const id of ["start", "to-simulate", "stop", "pause-team", "stop-actions", "relayout"]) {
      $(id).disabled = Boolean(orders.refusal);
      $(id).title =
        orders.refusal ||
        {
          stop: `Stop the run “${orders.runName}”`,
          "stop-actions": "The team pauses, and actions are cancelled; they start again on resume",
          relayout: "Lay out again",
        }[id] ||
        "";
    }
    this.robots.later();
    this.inspector.later();
  }

  theme(chosen) {
    const dark = chosen ? chosen === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
    document.documentElement.dataset.theme = dark ? "dark" : "light";
    this.line?.later();
    this.room?.update();
  }

  bind() {
    $("open-screen").onclick = () => this.openScreen(true);
    // a clicked tool button gives up the focus, so that Space works as a shortcut of the page again
    document.addEventListener("click", (event) => {
      if (event.detail) event.target.closest("#tools button, .zoom button, .scrub button")?.blur();
    });
    $("skip").onclick = (event) => {
      event.preventDefault();
      if (this.editor.mode) {
        $("ed-list").focus();
        return;
      }
      if (!this.model) {
        document.querySelector("#opening button")?.focus();
        return;
      }
      this.panels.open("left");
      $("list-search").focus();
    };
    $("help").onclick = () => showHelp(Boolean(this.editor.mode));
    $("theme").onclick = () => {
      const next = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
      localStorage.setItem("gspn-theme", next);
      this.theme(next);
    };
    $("zoom-in").onclick = () => this.view.camera.zoom(1.25);
    $("zoom-out").onclick = () => this.view.camera.zoom(0.8);
    $("fit").onclick = () => this.view.camera.fit();
    $("show-enabled").onclick = () => this.setShowEnabled(!this.showEnabled);
    $("relayout").onclick = () =>
      attempt(async () => this.view.relayout(await this.tools.do("layout")));
    $("play").onclick = () => this.togglePause();
    $("link-moment").onclick = () => attempt(() => linkMoment(this.model));
    $("back-to-live").onclick = () => attempt(() => this.model.backToLive());
    const scrubber = $("scrubber");
    scrubber.oninput = () => {
      this.line.sliding = true;
      attempt(() => this.model.show(Number(scrubber.value)));
    };
    scrubber.onchange = () => {
      this.line.sliding = false;
    };
    for (const tab of TABS) {
      $(`tab-${tab}`).onclick = () => this.openTab(tab);
      $(`tab-${tab}`).onkeydown = (event) => {
        const next = nextTab(event, TABS, tab);
        if (!next) return;
        this.openTab(next);
        $(`tab-${next}`).focus();
      };
    }
    $("start").onclick = () => this.start();
    $("stop").onclick = () => this.orders.order("stop");
    $("pause-team").onclick = () => {
      const { paused } = this.model.head.status;
      this.orders.give(
        paused ? "resume" : "pause",
        {},
        paused ? "Resume the team" : "Pause the team",
      );
    };
    $("stop-actions").onclick = () => this.orders.give("pause", { stop: true }, "Stop all actions");
    $("to-simulate").onclick = () => attempt(() => this.tools.do("simulate"));
  }

  async start() {
    const { scene } = this.model;
    const robots = scene.plan.robots.map(([name, place]) => `${name} in ${place}`).join(", ");
    const yours = scene.transitions
      .filter(({ environment, event, submits }) => environment && !event && !submits)
      .map(({ name }) => name);
    const answer = await ask(
      "Start the execution?",
      [
        h("p", `The actions of the plan “${scene.plan.name}” will run on this server now.`),
        h("p.muted", robots.length > 600 ? `${scene.plan.robots.length} robots` : robots),
        yours.length > 0 &&
          !scene.plan.environment &&
          h("p.muted", `Fired by you alone, in the inspector: ${yours.join(", ")}`),
      ],
      cancelOr("Start", "start"),
    );
    if (answer === "start") await attempt(() => this.tools.do("start", { confirmed: true }));
  }
}

new Page().boot();
