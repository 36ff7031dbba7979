"""The editor of the page in a browser: how long the page takes for each edit of a large net, with
its panels open."""

from __future__ import annotations

import json
import os
import tempfile
from collections import defaultdict
from typing import Any, Dict

from benchmarks.page.feed import workshop
from benchmarks.page.rendering import (
    SCREEN,
    chromium,
    percentile,
)
from gspn_framework_package.formats.net_json import net_to_json
from gspn_framework_package.model.net import Net
from gspn_framework_package.visualizer.documents import Folder
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.serving import WebServer

NAME = "large"
UNDONE = 1000
"""Edits that are made, undone and made again."""

ROWS = 500
"""Rows of the policy."""

PREPARE = """async (what) => {
  const { edit } = window.gspn;
  const { canvas, actions } = edit;
  const node = canvas.byKey.get("place:r0_p0");
  const box = canvas.container.getBoundingClientRect();
  const at = ([x, y]) => ({ clientX: x + box.left, clientY: y + box.top, pointerId: 1, button: 0,
    pointerType: "mouse", bubbles: true });
  const send = (type, point) => canvas.container.dispatchEvent(new PointerEvent(type, at(point)));
  canvas.container.setPointerCapture = () => {};
  const { k, x, y } = canvas.camera.now;
  const home = [node.x * k + x, node.y * k + y];
  const around = (n) => [home[0] + 60 * Math.sin(n / 9), home[1] + 60 * Math.cos(n / 9)];
  const type = (key, text) => {
    const field = document.querySelector(`input[data-key="${key}"]`);
    field.focus();
    field.value = text;
    field.dispatchEvent(new Event("input", { bubbles: true }));
  };
  const keys = (n) => (n % 2 ? actions.nudge(n % 4 > 1 ? 1 : -1, 0) : actions.count(1));
  const does = {
    drag: (n) => send("pointermove", around(n)),
    keys,
    add: (n) => actions.add(n % 2 ? "timed" : "place", 40 * n, -400),
    pan: (n) => canvas.camera.set(k, x + 60 * Math.sin(n / 9), y + 60 * Math.cos(n / 9)),
    zoom: (n) => canvas.camera.zoom(n % 20 < 10 ? 1.03 : 1 / 1.03),
    type: (n) => type("net.place:r0_p0.tokens", String(n % 9)),
    plan: keys,
    policy: (n) => type("policy.rows.3.marking.2", String(n % 9)),
    search: (n) => {
      edit.list.search.value = "r" + "0123456789"[n % 10];
      edit.list.search.dispatchEvent(new Event("input"));
    },
  }[what];
  const end = () => what === "drag" && send("pointerup", around(1));
  window.work = { does, end };
  edit.showPanel({ plan: "plan", policy: "policy" }[what] ?? "properties");
  edit.choose(["place:r0_p0"]);
  for (const details of document.querySelectorAll(".panel:not([hidden]) details"))
    details.open = true;
  await new Promise((done) => setTimeout(done, 500));
  if (what === "drag") send("pointerdown", home);
}"""

WORK = """async (seconds) => {
  const { does, end } = window.work;
  const frames = [], costs = [];
  const until = performance.now() + seconds * 1000;
  await new Promise((done) => {
    let n = 0;
    const tick = (t) => {
      frames.push(t);
      const begun = performance.now();
      does(n++);
      costs.push(performance.now() - begun);
      if (t < until) requestAnimationFrame(tick); else done();
    };
    requestAnimationFrame(tick);
  });
  end();
  document.activeElement.blur();
  return { frames, costs };
}"""

WORKS = ("drag", "keys", "add", "pan", "zoom", "type", "plan", "policy", "search")

UNDO = """async ([count]) => {
  const { edit } = window.gspn;
  const before = edit.document.state;
  edit.showPanel("properties");
  edit.choose(["place:r0_p1"]);
  for (let i = 0; i < count; i++)
    if (i % 2) edit.actions.move("a move", new Map([["r0_p1", [i, -i]]]));
    else edit.actions.add(i % 4 ? "timed" : "place", 40 * i, -800);
  const after = edit.document.state;
  const frame = () => new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
  const timed = async (act) => {
    await frame();
    const begun = performance.now();
    for (let i = 0; i < count; i++) act();
    await frame();
    return performance.now() - begun;
  };
  const undo = await timed(() => edit.undo());
  if (edit.document.state !== before) throw new Error("the edits were not undone");
  const redo = await timed(() => edit.redo());
  if (edit.document.state !== after) throw new Error("the edits were not made again");
  return { undo, redo };
}"""


def measure_editing(nodes: int, seconds: float) -> Dict[str, Any]:
    """Edit a plan with a net of about ``nodes`` nodes and a policy of :data:`ROWS` rows, once in
    each frame: a node is dragged, tokens and positions are changed by keys, nodes are added, the
    view is moved and zoomed, tokens are typed in the form of a place, keys are pressed beside the
    panel of the plan, a cell of the policy is typed, the list is searched. All sections of the
    panel that is shown are unfolded.

    :returns: for each of these ``frames_per_second``; ``code_p50_ms`` and ``code_p95_ms``, the
        time that the page's code takes for one; ``page_cpu_ms`` and ``drawing_cpu_ms``, the
        processor time for a frame of the thread of the page and of the one that puts the picture
        together, which work at the same time: unlike frames per second, they do not depend on what
        else the machine does. And the time (ms) until :data:`UNDONE` edits were undone, and made
        again, and drawn.
    """
    net = workshop(nodes)
    with tempfile.TemporaryDirectory() as folder:
        os.mkdir(os.path.join(folder, NAME))
        with open(os.path.join(folder, NAME, "plan.json"), "w", encoding="utf-8") as file:
            json.dump(_plan(net), file)
        server = WebServer(Project(Folder(folder), edits=True), port=0)
        server.start()
        try:
            return _measured(len(net.places) + len(net.transitions), server, seconds)
        finally:
            server.stop()


def _plan(net: Net) -> Dict[str, Any]:
    """A plan of the net: an action in each place, a policy of :data:`ROWS` rows."""
    tools = [p.name for p in net.places if p.name.endswith("tool")]
    robots = [p.name for p in net.places if not p.name.endswith("tool")]
    choices = [t.name for t in net.transitions if not t.timed]
    rows = [
        {"marking": [r % 7, r // 7 % 7, r // 49 % 7, "-"], "choose": {choices[r % len(choices)]: 1}}
        for r in range(ROWS)
    ]
    return {
        "plan": NAME,
        "net": net_to_json(net),
        "actions": dict.fromkeys(robots),
        "resource_places": tools,
        "policy": {"places": robots[:4], "rows": rows},
    }


def _measured(nodes: int, server: WebServer, seconds: float) -> Dict[str, Any]:
    result: Dict[str, Any] = {"nodes": nodes}
    with chromium() as browser:
        page = browser.new_page(viewport=SCREEN)
        page.set_default_timeout(120_000)
        page.goto(server.invitations["operator"])
        page.click("#opening button:has-text('%s')" % NAME)
        page.click("#ed-open")
        page.wait_for_selector("body[data-mode=EDIT][data-ready]")
        page.wait_for_timeout(2000)
        for what in WORKS:
            page.evaluate(PREPARE, what)
            browser.start_tracing(page=page, categories=["toplevel"])
            found = page.evaluate(WORK, seconds)
            busy = _thread_times(json.loads(browser.stop_tracing()))
            frames = found["frames"]
            result[what] = {
                "frames_per_second": round((len(frames) - 1) / (frames[-1] - frames[0]) * 1000, 1),
                "code_p50_ms": round(percentile(found["costs"], 50), 1),
                "code_p95_ms": round(percentile(found["costs"], 95), 1),
                "page_cpu_ms": round(busy["CrRendererMain"] / len(frames), 1),
                "drawing_cpu_ms": round(busy["VizCompositorThread"] / len(frames), 1),
            }
        for what, spent in page.evaluate(UNDO, [UNDONE]).items():
            result["%s_%d_ms" % (what, UNDONE)] = round(spent)
    return result


def _thread_times(trace: Dict[str, Any]) -> Dict[str, float]:
    """Processor time (ms) of the browser's threads in a trace, by their names. Of a name that
    several have (there is a renderer for each page), it is that of the busiest."""
    names = {}
    spent: Dict[Any, float] = defaultdict(float)
    for event in trace["traceEvents"]:
        thread = (event["pid"], event["tid"])
        if event["name"] == "thread_name":
            names[thread] = event["args"]["name"]
        elif event["name"] == "ThreadControllerImpl::RunTask" and "tdur" in event:
            spent[thread] += event["tdur"] / 1000
    result: Dict[str, float] = defaultdict(float)
    for thread, milliseconds in spent.items():
        name = names.get(thread, "")
        result[name] = max(result[name], milliseconds)
    return result
