"""Plans of behaviour trees of BehaviorTree.CPP: what a robot does is what the tree does."""

import json

import pytest

import gspn
from behaviour_trees import interpreted, kinds_of, random_script, random_tree, walked
from gspn_framework_package.cli.main import main
from gspn_framework_package.making import behaviour_tree
from gspn_framework_package.making.behaviour_tree import import_tree
from gspn_framework_package.model.errors import InputError, UsageError

ROOT = '<root BTCPP_format="4">\n%s\n</root>'
TREE = ROOT % '<BehaviorTree ID="Main">\n%s\n</BehaviorTree>'


@pytest.fixture(name="made")
def _made(tmp_path):
    """Returns a function that makes the plan of the text of a file."""

    def make(text, **more):
        (tmp_path / "tree.xml").write_text(text)
        return import_tree(str(tmp_path / "tree.xml"), **more)

    return make


def test_500_random_trees_do_what_their_nets_do(made):
    compared = ended = 0
    for seed in range(500):
        text, script = random_tree(seed), random_script(seed)
        try:
            plan = made(text)
        except InputError:
            continue
        found = walked(plan.net, kinds_of(plan.plan), script)
        assert found == interpreted(text, script), text
        compared += 1
        ended += found[1] is not None
    assert compared > 400
    assert ended > 300


@pytest.mark.parametrize(
    "body, script, leaves, ending",
    [
        ("<Sequence><A/><B/></Sequence>", [1, 1], "AB", True),
        ("<Sequence><A/><B/></Sequence>", [0], "A", False),
        ("<Fallback><A/><B/></Fallback>", [0, 1], "AB", True),
        ("<IfThenElse><A/><B/></IfThenElse>", [0], "A", False),
        ("<IfThenElse><A/><B/></IfThenElse>", [1, 0], "AB", False),
        ('<RetryUntilSuccessful num_attempts="2"><A/></RetryUntilSuccessful>', [0, 0], "AA", False),
        (
            '<RetryUntilSuccessful num_attempts="-1"><A/></RetryUntilSuccessful>',
            [0] * 9,
            "A" * 9,
            None,
        ),
        ('<Repeat num_cycles="3"><A/></Repeat>', [1, 1, 1], "AAA", True),
        ("<KeepRunningUntilFailure><A/></KeepRunningUntilFailure>", [1, 1, 0], "AAA", False),
        ('<Action ID="A" name="first"/>', [1], "A", True),
        ('<Condition ID="A"/>', [0], "A", False),
    ],
)
def test_a_node_does_what_its_documentation_says(made, body, script, leaves, ending):
    plan = made(TREE % body)
    assert walked(plan.net, kinds_of(plan.plan), script) == (list(leaves), ending)


@pytest.mark.parametrize(
    "body, message",
    [
        (
            "<Sequence>\n<Parallel><A/></Parallel></Sequence>",
            "tree.xml:4: <Parallel>: a robot does one",
        ),
        ("<ReactiveSequence><A/></ReactiveSequence>", "tree.xml:3: <ReactiveSequence>: "),
        ('<A _skipIf="x == 1"/>', "the script of _skipIf reads the blackboard"),
        ("<MyControl><A/></MyControl>", "only leaves can be your own"),
        ("<Inverter><A/><B/></Inverter>", "it has 2 children, not one"),
        ("<Sequence/>", "it has no child"),
        ('<SubTree ID="Other"/>', "there is no tree 'Other'"),
        ('<SubTree ID="Main"/>', "a subtree contains itself"),
        ('<Repeat num_cycles="many"><A/></Repeat>', "num_cycles is 'many', not a whole number"),
        ('<Timeout msec="5"><Sequence><A/></Sequence></Timeout>', "only the timeout of an action"),
        ('<Repeat num_cycles="6000"><A/></Repeat>', "more than 5000 leaves"),
        ('<Repeat num_cycles="900000000"><AlwaysSuccess/></Repeat>', "too many nodes"),
        ("<AlwaysSuccess/>", "begins with no action"),
        (
            "<Sequence><A/><KeepRunningUntilFailure><AlwaysSuccess/></KeepRunningUntilFailure></Sequence>",
            "repeats for ever a part that runs no action",
        ),
    ],
)
def test_what_a_plan_cannot_express_is_named_with_its_line(made, body, message):
    with pytest.raises(InputError) as told:
        made(TREE % body)
    assert message in str(told.value)


@pytest.mark.parametrize(
    "text, message",
    [
        ("<root><BehaviorTree/></root>", 'BTCPP_format="4"'),
        ("<pnml/>", "not a file of BehaviorTree.CPP"),
        ('<root BTCPP_format="4"><include path="a.xml"/><BehaviorTree ID="T"/></root>', "included"),
        ("<root", "not well-formed XML"),
    ],
)
def test_a_file_of_another_kind_is_refused(made, text, message):
    with pytest.raises(InputError, match=message):
        made(text)


def test_every_node_is_either_expressed_or_refused_with_a_reason():
    assert not set(behaviour_tree.WHY_NOT) & set(behaviour_tree._NODES)
    assert all(behaviour_tree.WHY_NOT.values())


def test_the_main_tree_is_asked_for_where_the_file_does_not_say_it(made):
    two = (
        ROOT
        % '<BehaviorTree ID="One"><A/></BehaviorTree><BehaviorTree ID="Two"><B/></BehaviorTree>'
    )
    with pytest.raises(UsageError, match="choose from One, Two"):
        made(two)
    assert list(kinds_of(made(two, tree="Two").plan).values()) == ["B"]


def test_ports_are_settings_and_those_of_a_subtree_are_put_in(made):
    plan = made(
        '<root BTCPP_format="4" main_tree_to_execute="Main">'
        '<BehaviorTree ID="Main"><SubTree ID="Go" goal="door" how="{speed}"/></BehaviorTree>'
        '<BehaviorTree ID="Go"><Move to="{goal}" at="{how}" name="Move there"/></BehaviorTree></root>'
    )
    assert plan.plan["actions"]["Move there"]["settings"] == {
        "node": "Move",
        "ports": {"to": "door", "at": "{speed}"},
    }
    assert plan.notes == [
        "line 1: Move: the port at is the entry {speed} of the blackboard; the function gets that text"
    ]


def test_times_are_kept(made):
    plan = made(
        TREE
        % '<Sequence><Sleep msec="250"/><Delay delay_msec="500"><Timeout msec="1500"><A/></Timeout></Delay></Sequence>'
    ).plan
    assert [plan["actions"][p]["settings"]["seconds"] for p in ("Wait 0.25 s", "Wait 0.5 s")] == [
        0.25,
        0.5,
    ]
    assert plan["timeout"] == {"A": 1.5}


def test_the_command_writes_a_plan_that_runs(tmp_path, capsys):
    (tmp_path / "tree.xml").write_text(
        TREE % "<Fallback><OpenDoor/><Sequence><BreakDoor/><BreakDoor/></Sequence></Fallback>"
    )
    folder = tmp_path / "plan"
    words = ["import", str(tmp_path / "tree.xml"), "-o", str(folder), "--robots", "2", "--json"]
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["places"] == 5
    actions = folder / "actions.py"
    text = actions.read_text().replace("is_cancelled.wait(0.1)", "is_cancelled.wait(0.01)")
    begin = text.index("return", text.index("def open_door"))
    actions.write_text(text[:begin] + 'raise OSError("stuck")\n    ' + text[begin:])
    plan = gspn.load(folder)
    assert plan.check().verdict == "may run"
    ran = plan.run(seconds=20)
    assert ran.reason == "until: SUCCESS + FAILURE >= 2"
    assert ran.marking["SUCCESS"] == 2
    assert sorted(firing["transition"] for firing in ran.firings) == sorted(
        ["OpenDoor fails", "BreakDoor succeeds", "BreakDoor 2 succeeds"] * 2
    )
    assert main(words) == 2
    assert "exists already" in capsys.readouterr().err
