"""The figures of the scaling experiments, as the thesis draws them (6.2, 6.4, 6.5, 6.6), and the
start-up time."""

from __future__ import annotations

import os
from typing import Any, Dict, List, Sequence

import psutil

Row = Dict[str, Any]

STYLES = {"process": "o-", "hosted": "s--"}

QUIET = 10.0
"""Highest load (%) of the processors before a run at which the machine's figures still reflect the
run (the thesis's baseline: 0.8 % CPU, 25.9 % memory)."""


def draw_figures(rows: Sequence[Row], folder: str) -> List[str]:
    """Draw the figures for which there are rows, as SVG; returns the names of the files."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    pyplot.rcParams.update(
        {"figure.figsize": (7, 4), "axes.grid": True, "grid.alpha": 0.3, "svg.hashsalt": "gspn"}
    )
    os.makedirs(folder, exist_ok=True)
    drawn: List[str] = []

    def save(name: str) -> None:
        path = os.path.join(folder, name + ".svg")
        pyplot.tight_layout()
        pyplot.savefig(path, metadata={"Date": None})
        pyplot.close()
        drawn.append(path)

    for experiment, number, key, label in (
        ("tokens", "6_2", "robots", "robots (tokens)"),
        ("places", "6_4", "places", "places, five robots"),
        ("one", "6_6", "places", "places, one robot"),
    ):
        for mode, points in _by_mode(rows, experiment).items():
            _, axis = pyplot.subplots()
            x = [row[key] for row in points]
            memory = psutil.virtual_memory().total / 1e6
            axis.plot(
                x,
                [row["cpu_percent_of_core"] / (os.cpu_count() or 1) for row in points],
                "^-",
                label="CPU of the robots' processes, % of the machine",
            )
            axis.plot(
                x,
                [100 * row["pss_mb"] / memory for row in points],
                "v-",
                label="memory of the robots' processes, %",
            )
            quiet = [row for row in points if row["baseline_cpu_percent"] <= QUIET]
            for what, style, name in (
                ("cpu", "o:", "CPU of the machine"),
                ("memory", "s:", "virtual memory"),
            ):
                over = [
                    row["machine_%s_percent" % what] - row["baseline_%s_percent" % what]
                    for row in quiet
                ]
                if quiet:
                    axis.plot(
                        [row[key] for row in quiet],
                        over,
                        style,
                        label=name + ", % over the baseline",
                    )
            axis.set_xlabel(label)
            axis.set_ylim(bottom=0)
            axis.legend()
            axis.set_title(
                "As Figure %s of the thesis (%s)" % (number.replace("_", "."), _mode_name(mode))
            )
            save("figure_%s_%s" % (number, mode))
    _draw_servers(rows, pyplot, save)
    _draw_start(rows, pyplot, save)
    return drawn


def _draw_servers(rows: Sequence[Row], pyplot: Any, save: Any) -> None:
    for mode in STYLES:
        both = [(name, _by_mode(rows, name).get(mode)) for name in ("tokens", "places")]
        if not all(points for _, points in both):
            continue
        _, axis = pyplot.subplots()
        for (_, points), style, label in zip(
            both, ("o-", "s-"), ("test 1: more robots", "test 2: more places")
        ):
            points = points or []
            axis.plot(
                [r["servers"] for r in points],
                [r["cpu_percent_of_core"] for r in points],
                style,
                label=label,
            )
        axis.set_xlabel("action servers")
        axis.set_ylabel("CPU of the robots' processes, % of one core")
        axis.set_ylim(bottom=0)
        axis.legend()
        axis.set_title("As Figure 6.5 of the thesis (%s)" % _mode_name(mode))
        save("figure_6_5_" + mode)


def _draw_start(rows: Sequence[Row], pyplot: Any, save: Any) -> None:
    found = _by_mode(rows, "tokens")
    if not found:
        return
    _, axis = pyplot.subplots()
    for mode, points in found.items():
        axis.plot(
            [r["robots"] for r in points],
            [r["all_fired_s"] for r in points],
            STYLES[mode],
            label="all robots fired, " + _mode_name(mode),
        )
    axis.plot([5], [9], "kx", label="published code: 5 robots in 9 s, 13 robots not within 90 s")
    axis.plot([], [], " ", label='thesis: "around 20 minutes, for more than 13 tokens"')
    axis.set_xlabel("robots, seven places each")
    axis.set_ylabel("s after roslaunch")
    axis.set_ylim(bottom=0)
    axis.legend()
    axis.set_title("From launch to the first firing of the last robot")
    save("start")


def _by_mode(rows: Sequence[Row], experiment: str) -> Dict[str, List[Row]]:
    found: Dict[str, List[Row]] = {}
    for row in rows:
        if (
            row["experiment"] == experiment
            and row["mode"] in STYLES
            and row.get("all_fired_s") is not None
        ):
            found.setdefault(row["mode"], []).append(row)
    return {
        mode: sorted(points, key=lambda r: (r["robots"], r["places"]))
        for mode, points in found.items()
    }


def _mode_name(mode: str) -> str:
    return "a process for each robot" if mode == "process" else "hosted in one process"
