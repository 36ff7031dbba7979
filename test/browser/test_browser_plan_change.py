"""A run that continues under another plan, in a browser: the net, the lists and the time line are
those of the moment shown."""

from deployed_log import write_deployed_log
from page_reading import marking, settle

FIRST, LATER = list("ABCD"), list("EXDBA")


def drawn(page):
    """The names of the places that are drawn, in the order of the net."""
    return page.evaluate("() => window.gspn.page.view.scene.places.map((p) => p.name)")


def show(page, n):
    page.evaluate("(n) => window.gspn.model.show(n)", n)
    settle(page, n)


def test_a_replay_changes_its_net_with_the_plan(serve_folder, open_page, tmp_path):
    write_deployed_log(str(tmp_path / "run.jsonl"))
    site = serve_folder(tmp_path)
    page = open_page(site.address + "#file-run.jsonl")
    page.wait_for_selector("#position:not(:has-text('reading the log:'))")
    hub = site.session("file-run.jsonl").hub
    changes = [e["n"] for e in hub.events(0, 10**6) if e["k"] == "plan"]
    assert drawn(page) == FIRST
    for n in (changes[0], changes[0] - 1, changes[1] + 5, 3, hub.board().n):
        show(page, n)
        assert drawn(page) == (FIRST if n < changes[0] else LATER)
        assert marking(page) == hub.board_at(n).marking
        assert page.locator("#net .place").count() == len(drawn(page))
    assert page.inner_text("#title") == "again"
    log = page.inner_text("#log")
    assert "leave_X" in log and "the team now follows the plan “again”" in log
    # played across the change, and stepped back over it
    show(page, changes[0] - 2)
    page.evaluate("(n) => window.gspn.model.forward(n)", changes[0] + 3)
    assert drawn(page) == LATER and marking(page) == hub.board_at(changes[0] + 3).marking
    assert "leave_C" in page.inner_text("#log")
    page.evaluate("() => window.gspn.model.stepView(-1)")
    page.wait_for_function("(n) => window.gspn.model.board.n < n", arg=changes[0] + 3)
    lanes = page.evaluate(
        """async () => {
          const { lanesOf } = await import("/static/js/course.js");
          const lanes = [...lanesOf(window.gspn.model, 0, 1e9).values()];
          return [...new Set(lanes.flatMap(({ parts }) => parts.map(([, , place]) => place)))];
        }"""
    )
    assert {"C", "D"} <= set(lanes) <= {*FIRST, *LATER}
