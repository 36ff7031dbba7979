"""A plan that is edited and deployed to a run of this server, with the mouse."""

import json

from deployed_log import round_of

ACTIONS = "def work(is_cancelled):\n    is_cancelled.wait(0.2)\n"


def plan(places, name):
    actions = dict.fromkeys(places, "actions.work")
    return {"plan": name, "net": round_of(places), "actions": actions, "robots": {"r": places[0]}}


def test_an_edited_plan_is_deployed_to_the_run(serve_folder, open_page, tmp_path):
    (tmp_path / "actions.py").write_text(ACTIONS)
    for name, places in (("three", "ABC"), ("four", "AXCD"), ("taking", "ABC")):
        data = plan(places, name)
        if name == "taking":
            data["net"]["transitions"].append({"name": "gone", "timed": True, "rate": 1})
            data["net"]["arcs"].append({"from": "A", "to": "gone"})
        (tmp_path / (name + ".json")).write_text(json.dumps(data))
    site = serve_folder(tmp_path, edits=True)
    live = open_page(site.address + "#file-three.json")
    live.click("#start")
    live.click("dialog button:has-text('Start')")
    live.wait_for_function(
        "() => window.gspn.model.mode === 'LIVE' && window.gspn.model.head.n > 3"
    )
    page = open_page(site.address + "#file-four.json&edit", ready=False)
    page.click("#ed-deploy")
    page.wait_for_selector("dialog h2:has-text('Deploy “four” to the team?')")
    assert "place X" in page.inner_text("dialog .ed-changes")
    assert "The check: may run." in page.inner_text("#dp-verdict")
    page.click("dialog button:has-text('Cancel')")
    page.click("#ed-deploy")
    page.select_option("#dp-map select[data-name='B']", "X")
    page.select_option("#dp-map select[data-name='leave_B']", "leave_X")
    page.click("dialog button:has-text('Deploy to the team')")
    page.wait_for_selector("#dp-state:has-text('Deployed: the run follows the plan')")
    assert "this server: can follow it" in page.inner_text("#dp-votes")
    live.wait_for_function("() => window.gspn.page.view.scene.name === 'four'")
    live.wait_for_function("() => window.gspn.model.board.plan === 1")
    assert live.evaluate("() => window.gspn.page.list.model.scene.places.map((p) => p.name)") == [
        *"AXCD"
    ]
    live.wait_for_function("() => document.querySelector('#log').innerText.includes('leave_D')")
    page.click("dialog button:has-text('Close')")
    page.goto(site.address + "#file-taking.json&edit")
    page.reload()
    page.click("#ed-deploy")
    page.wait_for_selector("#dp-verdict li:has-text('Error: gone takes 1 robot(s) and puts 0')")
    assert "The check: refused." in page.inner_text("#dp-verdict")
    assert page.locator("dialog button:has-text('Deploy to the team')").count() == 0
    site.session("file-three.json").command("stop", {})
    page.click("dialog button:has-text('Close')")
    page.click("#ed-deploy")
    page.wait_for_selector("text=there is no run that could take the plan")
