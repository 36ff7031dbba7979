"""What happens around the robots of the warehouse."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, List

import pytest

from gspn_framework_package.formats.example_plans import plans_folder
from gspn_framework_package.formats.plan_file import read_plan
from gspn_framework_package.model.errors import InputError
from gspn_framework_package.world.grid import Grid
from gspn_framework_package.world.room import Pose
from gspn_framework_package.world.room_file import load_room
from gspn_framework_package.world.shop import CustomerOrder, Shop, load_settings

FOLDER = plans_folder() + "/warehouse"


@pytest.fixture(scope="module")
def settings() -> Dict[str, Any]:
    return load_settings(FOLDER + "/shop.yaml")


def test_each_order_is_sent_twice_and_has_its_own_id(settings):
    shop = Shop(settings, seed=1, run="a")
    sent: List[CustomerOrder] = [
        order for tenth in range(6000) for order in shop.orders(tenth / 10)
    ]
    sent += [order for tenth in range(6000, 6100) for order in shop.orders(tenth / 10, False)]
    assert len(shop.ordered) > 10 and len(set(shop.ordered)) == len(shop.ordered)
    assert sorted(order.id for order in sent) == sorted(2 * shop.ordered)
    assert {order.shelf for order in sent} <= set(settings["shelves"])


def test_a_battery_runs_down_on_the_way_and_is_charged_at_the_charger(settings):
    shop = Shop(settings)
    x, y = settings["battery"]["charger"]
    assert shop.battery("r", Pose(0.0, 0.0), 0.0) == 1.0
    away = shop.battery("r", Pose(60.0, 0.0), 300.0)
    assert away == pytest.approx(1 - 60 / settings["battery"]["range"])
    assert shop.battery("r", Pose(60.0, 0.0), 900.0) == away
    shop.battery("r", Pose(x, y), 1200.0)
    here = shop.battery("r", Pose(x, y), 1201.0)
    later = shop.battery("r", Pose(x, y), 1202.0)
    assert later - here == pytest.approx(1 / settings["battery"]["charge_seconds"])
    assert shop.battery("r", Pose(x, y), 5000.0) == 1.0
    assert shop.battery("other", Pose(0.0, 0.0), 5000.0) == 1.0


def test_a_robot_can_stand_wherever_the_plan_sends_it(settings):
    room = load_room(FOLDER + "/warehouse.yaml")
    actions = read_plan(FOLDER + "/room.json").actions
    slots = [Pose(*s) for p in ("Park", "Loaded", "Low") for s in actions[p].settings["slots"]]
    stations = [
        actions[p].goal["target_pose"]["pose"]["position"]
        for p in ("Deliver.Dock_In", "Charge.Dock_In", "Deliver.Approach", "Charge.Approach")
    ]
    poses = slots + [Pose(*shelf) for shelf in settings["shelves"].values()]
    poses += [Pose(at["x"], at.get("y", 0.0)) for at in stations]
    field = Grid(room).field((room.spawn[0].x, room.spawn[0].y))
    for pose in poses:
        assert room.clearance(pose.x, pose.y) > room.robot.radius + 0.02, pose
        assert field.cost((pose.x, pose.y)) < float("inf"), pose
    for place in ("Park", "Loaded", "Low"):
        bay = [Pose(*slot) for slot in actions[place].settings["slots"]]
        apart = [a.distance(b) for i, a in enumerate(bay) for b in bay[:i]]
        assert min(apart) > 2 * room.robot.radius + 0.05
    charger = settings["battery"]["charger"]
    assert Pose(*charger).distance(Pose(stations[1]["x"], stations[1]["y"])) < 0.05


@pytest.mark.parametrize(
    "change, said",
    [
        (("range: 120", "range: 0"), "battery"),
        (("reach: 0.2", "rich: 0.2"), "battery"),
        (("mean: 22", "mean: often"), "orders"),
        (("shelves:", "shelves: ["), "not YAML"),
    ],
)
def test_a_wrong_file_is_refused_with_its_line(tmp_path: Path, change, said):
    text = Path(FOLDER, "shop.yaml").read_text(encoding="utf-8")
    file = tmp_path / "shop.yaml"
    file.write_text(text.replace(*change), encoding="utf-8")
    with pytest.raises(InputError, match=said) as caught:
        load_settings(str(file))
    assert caught.value.line is not None
    with pytest.raises(InputError, match="cannot read"):
        load_settings(str(tmp_path / "none.yaml"))
