#!/usr/bin/env python3
"""Films a real run: the page that shows it, and beside it the room in which the robots drive.

    python3 test/browser/film_demo.py docs/images/demo.webp

It starts a ROS master and ``patrol.launch``, opens the page in Chromium, and takes a picture of it
in each moment of the film, together with the room's newest moment in the recording. It needs a
built and sourced workspace, PyBullet and Playwright (scripts/requirements.txt).
"""

import argparse
import io
import json
import os
import sys
import time
from pathlib import Path

from PIL import Image, ImageDraw

sys.path.append(str(Path(__file__).resolve().parents[2]))

from benchmarks.harness.master import Master, need_ros
from benchmarks.harness.ports import free_port
from benchmarks.harness.team import launch_words
from benchmarks.page.rendering import chromium
from gspn_framework_package.model.errors import GspnError, InputError
from gspn_framework_package.world.camera import Camera, scalable_font
from gspn_framework_package.world.film import Film
from gspn_framework_package.world.physics import Physics
from gspn_framework_package.world.recording import read_recording

PAGE = (780, 660)
ROOM = (580, 435)
SIZE = (PAGE[0] + ROOM[0], PAGE[1])
LINES = (
    "One Petri net is the plan of the team:",
    "places are actions, tokens are robots.",
    "The robots agree on every firing,",
    "without a central node.",
)
PATIENCE = 90.0
"""Seconds that the start may take."""

PANELS = """localStorage.setItem("gspn-panels",
  JSON.stringify({ medium: { open: ["bottom"], sizes: { bottom: 168, log: 190 } } }))"""
"""Leaves the page its net and the robots' lanes."""


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("film", type=Path, metavar="FILM", help="a .webp, .gif or .mp4 file")
    parser.add_argument("--robots", type=int, default=4, help="size of the team (4)")
    parser.add_argument("--from", type=float, default=14, dest="start", help="start here (14 s)")
    parser.add_argument("--seconds", type=float, default=100, help="seconds of the run (100)")
    parser.add_argument("--speed", type=float, default=10, help="speed-up over the run (10)")
    parser.add_argument("--rate", type=float, default=10, help="pictures a second (10)")
    args = parser.parse_args()
    try:
        need_ros()
        film = Film(args.film, *SIZE, args.rate)
        with Master() as master:
            recording = Path(master.folder) / "room.jsonl"
            pages = list(film_page(args, master, recording))
            rooms = film_room(args, recording, [at for at, _ in pages])
            for (_, page), room in zip(pages, rooms):
                film.add(beside(page, room))
        film.close()
    except GspnError as error:
        print("film_demo: error: %s" % error, file=sys.stderr)
        return error.exit_code
    print("%s: %d pictures, %d kB" % (args.film, film.count, os.path.getsize(args.film) // 1000))
    return 0


def film_page(args, master, recording):
    """Yield the time of the room (s) and the page's picture then, while a team runs."""
    port = free_port()
    run = {"robots": args.robots, "run": "film"}
    page_server = launch_words("visualizer.launch", port=port, plan=patrol(), **run)
    master.programs.start("page", page_server)
    master.programs.start("patrol", launch_words("patrol.launch", record=recording, **run))
    with chromium() as browser:
        page = browser.new_page(viewport={"width": PAGE[0], "height": PAGE[1]})
        page.add_init_script(PANELS)
        open_page(page, "http://127.0.0.1:%d/" % port, master)
        step = args.speed / args.rate
        due = args.start
        while due <= args.start + args.seconds:
            moment = newest(recording)
            if moment < due:
                time.sleep(0.02)
                continue
            yield moment, Image.open(io.BytesIO(page.screenshot())).convert("RGB")
            due += step
    master.programs.stop("page", "patrol")


def patrol():
    """The plan of robots that drive."""
    return Path(__file__).resolve().parents[2] / "plans" / "patrol" / "room.json"


def open_page(page, address, master):
    """Open the page as soon as its server is there, with the net as large as it gets."""
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            page.goto(address)
            break
        except Exception:
            if time.monotonic() > deadline:
                raise InputError(
                    "the page did not come: %s" % master.programs.said("page")
                ) from None
            time.sleep(0.2)
    page.wait_for_selector("body[data-mode=LIVE][data-ready]", timeout=1000 * PATIENCE)
    page.keyboard.press("f")


def newest(recording):
    """The time of the recording's last whole line, in seconds; -1 before the first."""
    try:
        lines = recording.read_bytes()[-4000:].split(b"\n")
        return float(json.loads(lines[-2])[0])
    except (OSError, LookupError, TypeError, ValueError):
        return -1.0


def film_room(args, recording, times):
    """Yield the picture of the room at each of these times (s)."""
    read = read_recording(recording)
    poses = dict(read.moments)
    physics = Physics(read.room, read.robots, read.moments[0][1])
    camera = Camera(physics, *ROOM, "corner")
    for moment in times:
        for name, pose in zip(read.robots, poses[moment]):
            physics.show(name, pose)
        yield camera.picture(moment, "%g times as fast" % args.speed)


def beside(page, room):
    """One picture of both, with what they show written under the room."""
    whole = Image.new("RGB", SIZE, (245, 247, 250))
    whole.paste(page, (0, 0))
    whole.paste(room, (PAGE[0], 0))
    draw = ImageDraw.Draw(whole)
    draw.line([(PAGE[0], 0), (PAGE[0], SIZE[1])], (205, 210, 218), 2)
    for number, line in enumerate(LINES):
        at = (PAGE[0] + 40, ROOM[1] + 64 + 38 * number)
        draw.text(at, line, (27, 36, 48), scalable_font(20), "ls")
    return whole


if __name__ == "__main__":
    sys.exit(main())
