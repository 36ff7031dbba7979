"""The editor of the page in a browser: frames per second while a large net is edited."""

from __future__ import annotations

import json
import os
import tempfile
from collections import defaultdict
from typing import Any, Dict

from gspn_framework_package.benchmark.page.feed import workshop
from gspn_framework_package.benchmark.page.rendering import (
    SCREEN,
    chromium,
    percentile,
)
from gspn_framework_package.formats.net_json import net_to_json
from gspn_framework_package.visualizer.documents import Folder
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.serving import WebServer

NAME = "large"
UNDONE = 1000
"""Edits that are made and undone."""

WORK = """async ([what, seconds]) => {
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
  const does = {
    drag: (n) => send("pointermove", around(n)),
    edit: (n) => (n % 2 ? actions.nudge(n % 4 > 1 ? 1 : -1, 0) : actions.count(1)),
    add: (n) => actions.add(n % 2 ? "timed" : "place", 40 * n, -400),
    pan: (n) => canvas.camera.set(k, x + 60 * Math.sin(n / 9), y + 60 * Math.cos(n / 9)),
  }[what];
  edit.choose(["place:r0_p0"]);
  if (what === "drag") send("pointerdown", home);
  const frames = [], costs = [];
  const end = performance.now() + seconds * 1000;
  await new Promise((done) => {
    let n = 0;
    const tick = (t) => {
      frames.push(t);
      const begun = performance.now();
      does(n++);
      costs.push(performance.now() - begun);
      if (t < end) requestAnimationFrame(tick); else done();
    };
    requestAnimationFrame(tick);
  });
  if (what === "drag") send("pointerup", around(1));
  return { frames, costs };
}"""

UNDO = """(count) => {
  const { edit } = window.gspn;
  const before = edit.document.state;
  edit.choose(["place:r0_p1"]);
  for (let i = 0; i < count; i++) edit.actions.move("a move", new Map([["r0_p1", [i, -i]]]));
  const begun = performance.now();
  for (let i = 0; i < count; i++) edit.document.undo();
  const spent = performance.now() - begun;
  if (edit.document.state !== before) throw new Error("the edits were not undone");
  return spent;
}"""


def measure_editing(nodes: int, seconds: float) -> Dict[str, Any]:
    """Edit a net of about ``nodes`` nodes, once in each frame: a node is dragged, tokens and
    positions are changed, nodes are added, the view is moved.

    :returns: for each of these ``frames_per_second``; ``code_p50_ms``, the time that the page's
        code takes for one; ``page_cpu_ms`` and ``drawing_cpu_ms``, the processor time for a frame
        of the thread of the page and of the one that puts the picture together, which work at the
        same time: unlike frames per second, they do not depend on what else the machine does. And
        the time of undoing :data:`UNDONE` edits (ms).
    """
    net = workshop(nodes)
    plan = {"plan": NAME, "net": net_to_json(net), "actions": {}}
    with tempfile.TemporaryDirectory() as folder:
        os.mkdir(os.path.join(folder, NAME))
        with open(os.path.join(folder, NAME, "plan.json"), "w", encoding="utf-8") as file:
            json.dump(plan, file)
        server = WebServer(Project(Folder(folder), edits=True), port=0)
        server.start()
        try:
            return _measured(len(net.places) + len(net.transitions), server, seconds)
        finally:
            server.stop()


def _measured(nodes: int, server: WebServer, seconds: float) -> Dict[str, Any]:
    result: Dict[str, Any] = {"nodes": nodes}
    with chromium() as browser:
        page = browser.new_page(viewport=SCREEN)
        page.goto(server.invitations["operator"])
        page.click("#opening button:has-text('%s')" % NAME)
        page.click("#ed-open")
        page.wait_for_selector("body[data-mode=EDIT][data-ready]", timeout=60_000)
        page.wait_for_timeout(2000)
        for what in ("drag", "edit", "add", "pan"):
            browser.start_tracing(page=page, categories=["toplevel"])
            found = page.evaluate(WORK, [what, seconds])
            busy = _thread_times(json.loads(browser.stop_tracing()))
            frames = found["frames"]
            result[what] = {
                "frames_per_second": round((len(frames) - 1) / (frames[-1] - frames[0]) * 1000, 1),
                "code_p50_ms": round(percentile(found["costs"], 50), 1),
                "page_cpu_ms": round(busy["CrRendererMain"] / len(frames), 1),
                "drawing_cpu_ms": round(busy["VizCompositorThread"] / len(frames), 1),
            }
        result["undo_%d_ms" % UNDONE] = round(page.evaluate(UNDO, UNDONE))
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
