"""Data, tasks and events on the page: where they are shown, and how a task is submitted."""

import pytest
from reported_run import ReportedRun
from shop_plan import SLOTS, shop

from gspn_framework_package.execution.token_game import TokenGame
from gspn_framework_package.team.orders import ORDERS, PAGE
from gspn_framework_package.visualizer.team_events import TeamEvents


class Shop(ReportedRun):
    """A run of the shop whose log the test writes; tasks of the page go into it."""

    def __init__(self, plan):
        super().__init__(
            plan,
            {"run": "run_7"},
            commands=["fire", "submit", "cancel", "prioritise", "breakpoints"],
        )
        self.commands = {
            "breakpoints": self._halt,
            **{name: self._order(name) for name in ("submit", "cancel", "prioritise")},
        }
        self.game = TokenGame(plan)
        self.state = self.game.new_state()
        self.events = TeamEvents(self.game)
        self.events.board(True)

    def feed(self, *entries):
        step = self.game.reduce(self.state, self.state.next_slot, entries)
        self.hub.publish(*self.events.step(entries, step.firings, self.state))

    def _halt(self, fields):
        self.hub.change_info(breakpoints=fields["names"])
        return {"message": "robots stop there"}

    def _order(self, name):
        def order(fields):
            kind = ORDERS[name]
            entry = kind.entry(**kind.values(fields, PAGE, self.plan))
            self.feed(entry)
            return {"message": "task %s: %s" % (entry.id, name)}

        return order


@pytest.fixture(name="run")
def _run(show_net):
    plan = shop()
    run = Shop(plan)
    run.site = show_net(plan.net, plan, run)
    # the first to finish goes first, so that it is known who takes which task
    run.feed(run.game.start_entry()._replace(draws_ties=False))
    return run


def test_tasks_data_and_causes_are_shown_and_tasks_are_submitted(run, open_page, picture, axe):
    page = open_page(run.site.address)
    page.click("#list li:has-text('order')")
    page.wait_for_selector("#inspector button:has-text('Submit a task'):enabled")
    page.click("#inspector button:has-text('Submit a task')")
    page.wait_for_selector("dialog[open] h2:has-text('order')")
    page.fill("#order-id", "o1")
    page.fill("#order-data", '{"pose": [1, 0]')
    page.click("dialog button:has-text('Submit')")
    page.wait_for_selector("dialog .wrong:has-text('the data is not JSON')")
    page.fill("#order-data", '{"pose": [1, 0]}')
    page.click("dialog button:has-text('Submit')")
    page.wait_for_selector("#toast:has-text('task o1: submit')")

    for entries in SLOTS[:3]:
        run.feed(*entries)
    page.wait_for_selector("#inspector dd:has-text('o7')")  # it waits outside
    page.click("#list li:has-text('Orders')")
    page.wait_for_selector("#inspector .task >> nth=0 >> text=/task o3\\s*pose \\[3, 0\\]/")

    page.keyboard.press("2")
    page.wait_for_selector(".robot-card[data-robot='a'] .task:has-text('task o1')")
    page.wait_for_selector(".robot-card[data-robot='b'] .held:has-text('low: percentage: 0.15')")
    before = run.hub.board().n
    for entries in SLOTS[3:]:
        run.feed(*entries)
    page.wait_for_selector(".robot-card[data-robot='a'] .datum:has-text('charged 12')")
    page.wait_for_selector("#robots .team-data:has-text('door open')")
    page.wait_for_selector("#log li:has-text('low (percentage: 0.1)'):has-text('a → Charge')")
    page.wait_for_selector("#log li:has-text('task o1: a → done')")
    assert [task.id for _, task in run.state.submitted] == ["o7"]  # it still waits outside
    assert page.locator("#log li:has-text('task o7')").count() == 0
    picture(page, "reacting")
    # a breakpoint is set, marked on the net, told of a robot that halts there, and removed
    page.click("#list li[data-key='p1']")
    page.click("#inspector button:has-text('Set breakpoint')")
    page.wait_for_selector("#net .place.breaks")
    run.hub.publish({"k": "robots", "r": [{"name": "b", "paused": True}], "gone": []})
    page.wait_for_selector(
        "#inspector .robot-card[data-robot='b']:has-text('stops at a breakpoint')"
    )
    page.click("#inspector button:has-text('Remove breakpoint')")
    page.wait_for_selector("#net .place.breaks", state="detached")
    page.click("#list li[data-key='t1']")  # an immediate move from a place without an action
    page.wait_for_selector("#inspector h2:has-text('take')")
    assert page.locator("#inspector button:has-text('breakpoint')").count() == 0
    page.keyboard.press("2")
    # as it was then
    page.evaluate("(n) => window.gspn.model.show(n)", before)
    page.wait_for_selector(".robot-card[data-robot='b'] .held")
    page.wait_for_selector("#robots .team-data", state="detached")
    axe(page, "data and tasks", "right")


def test_tasks_are_submitted_with_a_priority_put_before_others_and_cancelled(run, open_page):
    page = open_page(run.site.address, expect_errors=True)  # a priority is refused
    for entries in SLOTS[:3]:
        run.feed(*entries)
    page.click("#list li:has-text('Orders')")
    page.wait_for_selector("#inspector .task >> nth=0 >> text=task o3")
    page.click("#inspector .task:has-text('task o5') button:has-text('Priority')")
    page.fill("#order-priority", "much")
    page.click("dialog button:has-text('Set the priority')")
    page.wait_for_selector("dialog .wrong:has-text('not a whole number')")
    page.fill("#order-priority", "7")
    page.click("dialog button:has-text('Set the priority')")
    page.wait_for_selector("#inspector .task >> nth=0 >> text=task o5")
    page.click("#inspector .task:has-text('task o3') button:has-text('Cancel')")
    page.click("dialog button:has-text('Cancel the task')")
    page.wait_for_selector("#inspector .task:has-text('task o3')", state="detached")
    page.keyboard.press("2")
    page.click(".robot-card[data-robot='a'] button:has-text('Cancel')")
    page.click("dialog button:has-text('Cancel the task')")
    page.wait_for_selector(".robot-card[data-robot='a'] .task", state="detached")
    assert [ended.outcome for ended in run.state.ended_tasks] == ["cancelled", "cancelled"]
