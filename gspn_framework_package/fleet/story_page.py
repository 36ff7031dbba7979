"""The story of a run as one HTML file, which needs no other file, no script and no network."""

from __future__ import annotations

import time
from html import escape
from typing import Dict, Iterator, List, Sequence, Tuple

from gspn_framework_package import __version__
from gspn_framework_package.fleet.run_story import (
    RunStory,
    length_text,
    longest_waits,
    time_by_use,
    time_text,
    waited_for,
)
from gspn_framework_package.fleet.stay_follower import USE_FAILED, USE_PAUSED, USES, Spell

SHOWN_WAITS, SHOWN_MOMENTS = 40, 400
"""Largest numbers of waits and moments in the file."""

_COLUMNS = 1200
"""Resolution of the time line."""

_LANE, _NAMES, _WIDTH = 22, 110, 1310
"""Height of a lane, width of the names, and width of the whole time line."""

_ALWAYS = (USE_FAILED, USE_PAUSED)
"""The uses of time that are drawn even if they are short."""

_STYLE = """
:root { color-scheme: light dark; --paper: #fff; --ink: #1d2733; --soft: #566270; --line: #d9dee5;
  --acting: #23689b; --waiting: #d79a2b; --paused: #8b97a5; --failed: #b3261e; --resting: #e4e8ed; }
@media (prefers-color-scheme: dark) { :root { --paper: #12171d; --ink: #e6ebf0; --soft: #a8b3bf;
  --line: #323c48; --acting: #6db3e2; --failed: #ff8b80; --resting: #2a333e; } }
body { margin: 0 auto; padding: 24px; max-width: 1100px; background: var(--paper);
  color: var(--ink); font: 14px/1.5 system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; }
h1 { font-size: 22px; margin: 0 0 4px; } h2 { font-size: 16px; margin: 28px 0 8px; }
p, figure { margin: 0 0 8px; } .soft, figcaption { color: var(--soft); }
svg { display: block; width: 100%; height: auto; } svg text { fill: var(--soft); font-size: 13px; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: 4px 14px 4px 0; border-bottom: 1px solid var(--line); text-align: right; }
th { color: var(--soft); font-weight: 600; } td.text, th.text { text-align: left; }
td.text { overflow-wrap: anywhere; } .when { white-space: nowrap; }
.scroll { overflow-x: auto; } a { color: var(--acting); }
.key { display: inline-block; width: 11px; height: 11px; margin: 0 5px 0 14px; }
""" + "".join(".%s { fill: var(--%s); background: var(--%s); }\n" % (u, u, u) for u in USES)


def story_page(story: RunStory, name: str, link: str = "") -> str:
    """The story as an HTML document.

    :param name: the name of the log, for people.
    :param link: the address of the replay of the run, if there is one; the slot is added.
    """
    title = "Run %s" % story.run
    parts = [
        "<!doctype html>\n<html lang=en><head><meta charset=utf-8>",
        '<meta name=viewport content="width=device-width, initial-scale=1">',
        "<title>%s</title><style>%s</style></head><body>" % (escape(title), _STYLE),
        "<h1>%s</h1>" % escape(title),
        "<p class=soft>%s</p>" % escape(_summary(story)),
        *_time_line(story),
        *_awaited(story),
        *_waits(story, link),
        *_moments(story, link),
        *_robots(story),
        "<p class=soft>%s</p></body></html>\n"
        % escape(
            "Made from %s by gspn_framework_package %s. “gspn replay %s” plays it."
            % (name, __version__, name)
        ),
    ]
    return "\n".join(parts)


def _summary(story: RunStory) -> str:
    said = ["Plan %s" % story.plan, "%d robots" % len(story.spells), "%d firings" % story.firings]
    began = ""
    if story.began is not None:
        began = time.strftime(" from %Y-%m-%d %H:%M:%S UTC", time.gmtime(story.began))
    said.append(length_text(story.seconds) + began)
    if story.recorder:
        said.append("as %s recorded it" % story.recorder)
    said.append("ended: %s" % story.ended if story.ended else "the log does not say that it ended")
    return ", ".join(said) + "."


def _when(t: float, slot: int, link: str) -> str:
    """A time, as a link to its replay if there is one."""
    if not link:
        return time_text(t)
    return '<a href="%s&amp;slot=%d">%s</a>' % (escape(link), slot, time_text(t))


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]], texts: int) -> Iterator[str]:
    """A table of cells of HTML, the first and those from number ``texts`` on left-aligned."""

    def row(cells: Sequence[str], tag: str) -> str:
        kinds = [" class=text" if not i or i >= texts else "" for i in range(len(cells))]
        return "<tr>%s</tr>" % "".join(
            "<%s%s>%s</%s>" % (tag, kind, cell, tag) for kind, cell in zip(kinds, cells)
        )

    yield "<div class=scroll><table>" + row(heads, "th")
    yield from (row(cells, "td") for cells in rows)
    yield "</table></div>"


def _time_line(story: RunStory) -> Iterator[str]:
    robots = sorted(story.spells)
    height = _LANE * len(robots) + 20
    yield "<h2>Time line</h2><figure>"
    yield '<svg viewBox="0 0 %d %d" role=img aria-label="What each robot did, over time">' % (
        _WIDTH,
        height,
    )
    for number, robot in enumerate(robots):
        y = number * _LANE
        yield '<text x=0 y=%d textLength="%d" lengthAdjust=spacingAndGlyphs>%s</text>' % (
            y + 15,
            min(_NAMES - 8, 8 * len(robot)),
            escape(robot),
        )
        for spell, first, last in _drawn(story.spells[robot], story.seconds):
            yield "<rect class=%s x=%d y=%d width=%d height=%d><title>%s</title></rect>" % (
                *(spell.use, _NAMES + first, y + 3, last - first, _LANE - 6),
                escape(_in_words(spell)),
            )
    for i in range(6):
        anchor = "start" if i < 5 else "end"
        yield "<text x=%d y=%d text-anchor=%s>%s</text>" % (
            *(_NAMES + i * _COLUMNS // 5, height - 4, anchor),
            time_text(i * story.seconds / 5),
        )
    keys = "".join("<span class='key %s'></span>%s" % (use, use) for use in USES)
    yield "</svg><figcaption>%s</figcaption></figure>" % keys


def _in_words(spell: Spell) -> str:
    times = time_text(spell.begin), time_text(spell.end), length_text(spell.end - spell.begin)
    return "%s, %s in %s: %s to %s (%s)" % (spell.robot, spell.use, spell.place, *times)


def _drawn(spells: Sequence[Spell], seconds: float) -> Iterator[Tuple[Spell, int, int]]:
    """The spells that can be seen, each with its first column and the one after its last. Of
    several in one column, that of a failure or a pause is drawn, or else the longest there."""
    columns: List[int] = [-1] * _COLUMNS
    best = [(False, 0.0)] * _COLUMNS
    scale = _COLUMNS / max(seconds, 1e-9)
    for number, spell in enumerate(spells):
        begin, end = spell.begin * scale, spell.end * scale
        for column in range(min(_COLUMNS - 1, int(begin)), min(_COLUMNS, int(end) + 1)):
            here = min(end, column + 1) - max(begin, column)
            rank = (spell.use in _ALWAYS, here)
            if rank > best[column]:
                best[column], columns[column] = rank, number
    first = 0
    for column in range(1, _COLUMNS + 1):
        if column == _COLUMNS or columns[column] != columns[first]:
            if columns[first] >= 0:
                yield spells[columns[first]], first, column
            first = column


def _awaited(story: RunStory) -> Iterator[str]:
    rows = waited_for(story)
    yield "<h2>Who was waited for</h2>"
    if not rows:
        yield "<p>No robot waited for another.</p>"
        return
    yield from _table(
        ["Robot", "Others waited", "Waits", "Which"],
        [
            [
                escape(row["robot"]),
                length_text(row["seconds"]),
                str(row["waits"]),
                escape(", ".join(row["by"])),
            ]
            for row in rows
        ],
        3,
    )


def _waits(story: RunStory, link: str) -> Iterator[str]:
    yield "<h2>The longest waits</h2>"
    waits = longest_waits(story, SHOWN_WAITS)
    if not waits:
        yield "<p>No robot waited.</p>"
        return
    yield from _table(
        ["From", "Seconds", "What and why"],
        [
            [
                "<span class=when>%s</span>" % _when(wait.begin, wait.slot, link),
                "%.1f" % wait.seconds,
                "<b>%s</b> %s" % (escape(wait.robot), escape(wait.text())),
            ]
            for wait in waits
        ],
        2,
    )
    if len(story.waits) > SHOWN_WAITS:
        yield "<p class=soft>%d shorter ones are not listed.</p>" % (len(story.waits) - SHOWN_WAITS)
    places: Dict[str, float] = {}
    for wait in story.waits:
        places[wait.place] = places.get(wait.place, 0.0) + wait.seconds
    most = sorted(places.items(), key=lambda item: -item[1])[:5]
    yield "<p>The longest waits were in %s.</p>" % escape(
        ", ".join("%s (%s)" % (place, length_text(seconds)) for place, seconds in most)
    )


def _moments(story: RunStory, link: str) -> Iterator[str]:
    yield "<h2>What happened</h2>"
    if not story.moments:
        yield "<p>No failure, alarm or order.</p>"
        return
    if len(story.moments) > SHOWN_MOMENTS:
        left_out = len(story.moments) - SHOWN_MOMENTS
        yield "<p class=soft>The last %d; %d earlier ones are not listed.</p>" % (
            SHOWN_MOMENTS,
            left_out,
        )
    yield from _table(
        ["When", "What", "Who and where", "Detail"],
        [
            [
                "<span class=when>%s</span>" % _when(moment.at, moment.slot, link),
                moment.what,
                escape(moment.where),
                escape(moment.detail),
            ]
            for moment in story.moments[-SHOWN_MOMENTS:]
        ],
        1,
    )


def _robots(story: RunStory) -> Iterator[str]:
    yield "<h2>What the robots spent their time on</h2>"
    rows = []
    for robot, times in time_by_use(story).items():
        whole = sum(times.values()) or 1.0
        shares = ["%.1f %%" % (100 * times[use] / whole) for use in USES]
        rows.append([escape(robot), length_text(whole), *shares])
    yield from _table(["Robot", "Time", *(use.capitalize() for use in USES)], rows, 7)
