"""Why a transition cannot fire, as the page shows it: by the token game's own rules."""

from page_client import PageClient
from reported_run import ReportedRun

from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.model.net import Arc
from gspn_framework_package.model.plan import Plan, RobotSpec
from gspn_framework_package.model.policy import Policy
from gspn_framework_package.visualizer.documents import Document
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.session import Session


def asking(net, plan=None, activity=None):
    project = Project()
    session = Session("net", Document("net", net, plan), activity)
    project.show(session)
    client = PageClient(project)

    def ask(transition, **query):
        text = "".join("&%s=%s" % pair for pair in query.items())
        return client.get("/api/reasons?id=net&transition=%s%s" % (transition, text)).get_json()

    return client, ask


def test_parallel_arcs_count_together():
    net = NetBuilder().place("p", 1).exponential("t", inputs="p").build().with_arc(Arc("p", "t", 1))
    _, ask = asking(net)
    assert ask("t") == {
        "transition": "t",
        "enabled": False,
        "reasons": ["p has 1 of 2 tokens"],
        "at": 0,
    }


def test_a_full_place_that_gives_as_much_as_it_takes_is_no_reason():
    net = NetBuilder().place("full", 2, capacity=2).place("p", 0)
    net.exponential("loop", inputs={"full": 1, "p": 1}, outputs="full")
    net.exponential("two", outputs={"full": 2}).place("almost", 1, capacity=2).exponential(
        "fill", outputs={"almost": 2}
    )
    _, ask = asking(net.build())
    assert ask("loop")["reasons"] == ["p has 0 of 1 token"]
    assert ask("two")["reasons"] == ["full is full (capacity 2)"]
    assert ask("fill")["reasons"] == ["almost has room for 1 of 2 more tokens (capacity 2)"]


def test_who_goes_first_is_named():
    net = NetBuilder().place("p", 1).exponential("slow", inputs="p")
    net.immediate("low", inputs="p", priority=1).immediate("high", inputs="p", priority=2)
    _, ask = asking(net.build())
    assert ask("slow")["reasons"] == ["high goes first (immediate)"]
    assert ask("low")["reasons"] == ["high goes first (higher priority)"]
    assert ask("high") == {"transition": "high", "enabled": True, "reasons": [], "at": 0}


def test_it_is_answered_for_the_moment_that_is_shown():
    net = NetBuilder().place("a", 1).place("b").exponential("t", inputs="a", outputs="b").build()
    client, ask = asking(net)
    client.do("step", session="net")
    assert ask("t") == {
        "transition": "t",
        "enabled": False,
        "reasons": ["a has 0 of 1 token"],
        "at": 1,
    }
    assert ask("t", at=0) == {"transition": "t", "enabled": True, "reasons": [], "at": 0}


def test_in_a_run_it_is_reported_which_robots_are_awaited():
    plan = read_plan("plans/patrol")
    team = ReportedRun(plan)
    _, ask = asking(plan.net, plan, team)
    robot = plan.robots[0]
    t = plan.net.transitions[plan.net.consumers[plan.net.place_index[robot.place]][0]].name
    assert ask(t)["enabled"] and ask(t)["reasons"] == ["%s: 0 of 1 robot is done" % robot.place]
    team.hub.publish({"k": "robots", "r": [{"name": robot.name, "phase": "done"}], "gone": []})
    assert ask(t)["enabled"] and ask(t)["reasons"] == []


def test_an_unknown_transition_or_moment_is_reported():
    client, _ = asking(NetBuilder().place("p", 1).exponential("t", inputs="p").build())
    for query in ("", "&transition=nothing", "&transition=t&at=x"):
        assert client.get("/api/reasons?id=net" + query).status_code == 400


def test_in_a_run_it_is_reported_what_the_policy_says():
    net = NetBuilder().place("here", 1).place("other", 1).place("there").place("light")
    net.immediate("go", inputs="here", outputs="there").immediate("stay", inputs="here")
    net.immediate("leave", inputs="other", outputs="there")
    net.exponential("back", inputs="there", outputs="here")
    built = net.build()
    rows = [(("-", 0), {"go": 0.75, "stay": 0.25}), ((2, "-"), {})]
    asked = {}
    for here in (1, 2):
        marked = built.with_marking({"here": here, "other": 1})
        robots = [RobotSpec("r%d" % k, "here") for k in range(here)] + [RobotSpec("x", "other")]
        plan = Plan(
            marked,
            policy=Policy.from_table(["here", "light"], rows),
            robots=tuple(robots),
            resource_places=frozenset(["light"]),
        ).validate()
        _, ask = asking(marked, plan, ReportedRun(plan))
        asked[here] = [ask(t)["reasons"][-1] for t in ("go", "leave")]
    assert asked[1] == [
        "row 1 of the policy: from here, go (75 %), stay (25 %)",
        "no policy row applies to other in this marking: robots wait there",
    ]
    assert asked[2][0] == "row 1 of the policy: from here, go (75 %), stay (25 %)"
    assert asked[2][1] == "row 2 of the policy lets robots wait in other"
