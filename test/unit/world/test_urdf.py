"""Robots of the user: a room whose robots come from a URDF."""

import math

import pytest
from test_world_robot import HALL

from gspn_framework_package.model.errors import InputError
from gspn_framework_package.world.bodies import quiet
from gspn_framework_package.world.driving_team import DrivingTeam
from gspn_framework_package.world.models import Placed
from gspn_framework_package.world.navigation import NavigationStatus
from gspn_framework_package.world.robot_urdf import robot_urdf
from gspn_framework_package.world.room import ROBOT_TYPES, Pose
from gspn_framework_package.world.room_file import load_room

# A robot whose centre of mass is behind its axis, whose right wheel turns the other way round, with
# a caster that turns and no base_footprint.
CART = """<robot name="cart">
  <link name="base">
    <inertial><origin xyz="-0.06 0.01 0.05" rpy="0.2 0 0.4"/><mass value="4"/>
      <inertia ixx="0.03" iyy="0.05" izz="0.06" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="-0.05 0 0.02"/><geometry><box size="0.3 0.2 0.1"/></geometry></collision>
  </link>
  <link name="left">%(wheel)s</link>
  <link name="right">%(wheel)s</link>
  <link name="caster"><inertial><mass value="0.05"/>
      <inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><sphere radius="0.02"/></geometry></collision></link>
  <joint name="to_left" type="continuous"><parent link="base"/><child link="left"/>
    <origin xyz="0 0.12 0" rpy="-1.5707963 0 0"/><axis xyz="0 0 1"/></joint>
  <joint name="to_right" type="continuous"><parent link="base"/><child link="right"/>
    <origin xyz="0 -0.12 0" rpy="1.5707963 0 0"/><axis xyz="0 0 1"/></joint>
  <joint name="to_caster" type="continuous"><parent link="base"/><child link="caster"/>
    <origin xyz="-0.15 0 -0.03"/><axis xyz="0 0 1"/></joint>
</robot>
""" % {
    "wheel": '<inertial><mass value="0.2"/><inertia ixx="1e-4" iyy="1e-4" izz="2e-4" ixy="0" ixz="0"'
    ' iyz="0"/></inertial><collision><geometry><cylinder radius="0.05" length="0.03"/></geometry>'
    "</collision>"
}
INERTIAL = CART[CART.index("<inertial>") : CART.index("</inertial>") + len("</inertial>")]
WHEELS = "robot: {urdf: cart.urdf, wheel_joints: [to_left, to_right]}\n"


def room(folder, urdf=CART, robot=WHEELS):
    (folder / "cart.urdf").write_text(urdf)
    (folder / "room.yaml").write_text(HALL + robot)
    return load_room(folder / "room.yaml")


@pytest.mark.parametrize("model", sorted(ROBOT_TYPES))
def test_our_own_description_is_read_as_what_it_describes(tmp_path, model):
    kind = ROBOT_TYPES[model]
    own = room(tmp_path, robot_urdf(kind), "robot: {urdf: cart.urdf, model: %s}\n" % model).robot
    assert own.wheel_radius == pytest.approx(kind.wheel_radius)
    assert own.wheel_separation == pytest.approx(kind.wheel_separation)
    assert own.mass == pytest.approx(kind.mass + 0.06)
    assert own.radius == pytest.approx(kind.radius, abs=0.0005)
    assert own.max_speed == kind.max_speed


def test_a_robot_of_ones_own_drives_where_it_is_sent(tmp_path):
    team = DrivingTeam(room(tmp_path), ["robot_1"])
    kind, physics = team.room.robot, team.physics
    try:
        assert kind.radius == pytest.approx(math.hypot(0.2, 0.1), abs=0.01)
        assert physics.pose("robot_1").distance((0.0, 0.0)) < 0.002
        team.navigators["robot_1"].go(Pose(1.2, 0.8, 1.0), team.time)
        while team.navigators["robot_1"].active and team.time < 60.0:
            team.step()
        assert team.navigators["robot_1"].status is NavigationStatus.REACHED
        pose = physics.pose("robot_1")
        assert pose.distance((1.2, 0.8)) < 0.1 and abs(pose.yaw - 1.0) < 0.2
        assert physics.odometry("robot_1")[0].distance(pose) < 0.05
        assert physics.contacts.total == 0
        left, right = physics.wheels("robot_1")
        assert left[0] > 0.0 > right[0]  # as its joints are
        physics.carry("robot_1", Pose(-1.0, 0.5, 2.0))
        there = physics.pose("robot_1")
        assert there.distance((-1.0, 0.5)) < 0.001 and there.yaw == pytest.approx(2.0, abs=0.01)
    finally:
        team.close()


def test_a_link_without_inertial_adds_no_mass_and_a_mesh_its_size(tmp_path):
    foot = '<link name="foot"/><joint name="up" type="fixed"><parent link="foot"/><child link="base"/></joint>'
    (tmp_path / "bar.obj").write_text(
        "v -0.5 0 -0.02\nv 0.1 0 -0.02\nv 0.1 0 0.1\nv -0.5 0 0.1\nf 1 2 3\nf 1 3 4\n"
    )
    bar = '<mesh filename="bar.obj"/>'
    cart = CART.replace('<link name="base">', foot + '<link name="base">')
    team = DrivingTeam(room(tmp_path, cart.replace('<sphere radius="0.02"/>', bar, 1)), ["robot_1"])
    try:
        client = team.physics.client
        bodies = [client.getBodyUniqueId(n) for n in range(client.getNumBodies())]
        mass, _, inertia = max(client.getDynamicsInfo(body, -1)[:3] for body in bodies)
        assert mass == pytest.approx(4.05, abs=1e-3)
        assert max(inertia) == pytest.approx(0.061, abs=1e-3)
        assert team.room.robot.radius == pytest.approx(0.65, abs=0.03)
    finally:
        team.close()


@pytest.mark.parametrize(
    ("change", "robot", "said"),
    [
        (("<robot", "<sdf"), WHEELS, "cart.urdf"),
        (("", ""), "robot: {urdf: none.urdf}\n", "none.urdf"),
        (("", ""), "robot: {urdf: cart.urdf}\n", "no joint 'wheel_left_joint'"),
        (('<mass value="0.2"/>', ""), WHEELS, "link 'left': its <inertial> has no <mass>"),
        (('<mass value="4"/>', '<mass value="four"/>'), WHEELS, "<mass> is not a number"),
        (('ixx="0.03"', ""), WHEELS, "link 'base': the ixx of its <inertia> is not a number"),
        (('ixx="0.03"', 'ixx="0"'), WHEELS, "the ixx of its <inertia> is not more than 0"),
        ((INERTIAL, ""), WHEELS, "link 'base': neither it nor what is fixed to it has"),
        (('size="0.3 0.2 0.1"', 'size="0.3 -1 0.1"'), WHEELS, "the size of its <box> is not more"),
        (('<sphere radius="0.02"/>', '<mesh filename="cart.urdf"/>'), WHEELS, "does not load"),
        (('<sphere radius="0.02"/>', "<capsule/>"), WHEELS, "<capsule> is not read"),
        (('xyz="0 0.12 0"', 'xyz="0.1 0.12 0"'), WHEELS, "the wheels are at (0.1, 0.12)"),
        (('xyz="0 0.12 0" rpy="-1.5707963 0 0"', 'xyz="0 0.12 0"'), WHEELS, "not across"),
        (('<sphere radius="0.02"/>', '<mesh filename="a.stl"/>'), WHEELS, "no mesh 'a.stl'"),
        (('<sphere radius="0.02"/>', '<mesh filename="b.obj"/>'), WHEELS, "a point that is not in"),
        (('<sphere radius="0.02"/>', '<sphere radius="big"/>'), WHEELS, "link 'caster'"),
        (('<child link="caster"/>', '<child link="base"/>'), WHEELS, "not a tree"),
        (('<child link="caster"/>', '<child link="nothing"/>'), WHEELS, "'nothing'"),
        (('name="base"', 'name="xacro_base"'), WHEELS, "'base'"),
    ],
)
def test_what_is_wrong_in_a_urdf_is_named(tmp_path, change, robot, said):
    (tmp_path / "b.obj").write_text("v 0 0 0\nv 1 0 0\nf 1 2 3\n")
    with pytest.raises(InputError) as error, quiet(2):
        room(tmp_path, CART.replace(*change) if change[0] else CART, robot)
    assert said in str(error.value)


def test_robots_drive_around_a_model_that_is_put_into_the_room(tmp_path):
    team = DrivingTeam(room(tmp_path), ["robot_1"])
    models = team.models
    try:
        crate = '<robot name="c"><link name="base"><collision><geometry>%s</geometry></collision></link></robot>'
        models.spawn(
            "crate", crate % '<cylinder radius="0.2" length="0.5"/>', Placed(Pose(1.0, 0.0), 0.25)
        )
        team.navigators["robot_1"].go(Pose(1.6, 0.0), team.time)
        far = 0.0
        while team.navigators["robot_1"].active and team.time < 60.0:
            team.step()
            far = max(far, abs(team.physics.pose("robot_1").y))
        assert team.navigators["robot_1"].status is NavigationStatus.REACHED
        assert team.physics.contacts.total == 0 and far > 0.35
        seen = models.seen_from("robot_1", models.placed("crate"))
        assert math.hypot(seen.pose.x, seen.pose.y) == pytest.approx(0.6, abs=0.1)
        back = models.in_map("robot_1", seen)
        assert back.pose.distance((1.0, 0.0)) < 1e-9 and back.height == 0.25
        for name, place, said in [
            ("crate", Pose(0.0, 1.0), "already"),
            ("other", team.physics.pose("robot_1"), "robot_1 stands there"),
        ]:
            with pytest.raises(ValueError, match=said):
                models.spawn(name, crate % '<box size="0.1 0.1 0.1"/>', Placed(place))
        with pytest.raises(ValueError, match="does not fit"):
            models.move("robot_1", Placed(Pose(1.0, 0.1)))
        models.move("crate", Placed(Pose(-1.0, 0.0), 0.25))
        models.move("robot_1", Placed(Pose(1.0, 0.1)))
        models.delete("crate")
        assert models.names() == ["robot_1"] and not models.solids()
    finally:
        team.close()
