"""What installs the package agrees with itself: package.xml, setup.py, the lists in scripts/."""

import ast
import json
import re
import runpy
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
import yaml

import gspn_framework_package
from gspn_framework_package.model.errors import EXTRAS

ROOT = Path(__file__).resolve().parents[2]
MANIFEST = ElementTree.parse(str(ROOT / "package.xml")).getroot()

BASE, PYTHON = "rosdep/base.yaml", "rosdep/python.yaml"
#: The keys of package.xml -> (where rosdep's published lists, github.com/ros/rosdistro, define it
#: for Ubuntu focal with Noetic: a file, or a repository of noetic/distribution.yaml; what it
#: installs there). A key that is not in those lists stops ``rosdep install``, so whoever adds one
#: looks it up there.
#: Each line of PYTHON was read there (commit 000730d), but for waitress, which is younger (pull
#: request 38185 of August 2023): who has an older list runs ``rosdep update`` first.
ROSDEP = {
    "actionlib": ("actionlib", "ros-noetic-actionlib"),
    "actionlib_msgs": ("common_msgs", "ros-noetic-actionlib-msgs"),
    "catkin": ("catkin", "ros-noetic-catkin"),
    "diagnostic_msgs": ("common_msgs", "ros-noetic-diagnostic-msgs"),
    "genmsg": ("genmsg", "ros-noetic-genmsg"),
    "genpy": ("genpy", "ros-noetic-genpy"),
    "geometry_msgs": ("common_msgs", "ros-noetic-geometry-msgs"),
    "graphviz": (BASE, "graphviz"),
    "joint_state_publisher": ("joint_state_publisher", "ros-noetic-joint-state-publisher"),
    "message_generation": ("message_generation", "ros-noetic-message-generation"),
    "message_runtime": ("message_runtime", "ros-noetic-message-runtime"),
    "move_base_msgs": ("navigation_msgs", "ros-noetic-move-base-msgs"),
    "nav_msgs": ("common_msgs", "ros-noetic-nav-msgs"),
    "python3-cryptography": (PYTHON, "python3-cryptography"),
    "python3-flask": (PYTHON, "python3-flask"),
    "python3-jsonschema": (PYTHON, "python3-jsonschema"),
    "python3-lxml": (PYTHON, "python3-lxml"),
    "python3-matplotlib": (PYTHON, "python3-matplotlib"),
    "python3-numpy": (PYTHON, "python3-numpy"),
    "python3-pil": (PYTHON, "python3-pil"),
    "python3-psutil": (PYTHON, "python3-psutil"),
    "python3-pytest": (PYTHON, "python3-pytest"),
    "python3-rospkg": (PYTHON, "python3-rospkg"),
    "python3-scipy": (PYTHON, "python3-scipy"),
    "python3-setuptools": (PYTHON, "python3-setuptools"),
    "python3-waitress": (PYTHON, "python3-waitress"),
    "python3-yaml": (PYTHON, "python3-yaml"),
    "robot_state_publisher": ("robot_state_publisher", "ros-noetic-robot-state-publisher"),
    "rosbag": ("ros_comm", "ros-noetic-rosbag"),
    "rosbash": ("ros", "ros-noetic-rosbash"),
    "rosgraph": ("ros_comm", "ros-noetic-rosgraph"),
    "rosgraph_msgs": ("ros_comm_msgs", "ros-noetic-rosgraph-msgs"),
    "roslaunch": ("ros_comm", "ros-noetic-roslaunch"),
    "roslib": ("ros", "ros-noetic-roslib"),
    "rospy": ("ros_comm", "ros-noetic-rospy"),
    "rostest": ("ros_comm", "ros-noetic-rostest"),
    "rosunit": ("ros", "ros-noetic-rosunit"),
    "sensor_msgs": ("common_msgs", "ros-noetic-sensor-msgs"),
    "std_msgs": ("std_msgs", "ros-noetic-std-msgs"),
    "std_srvs": ("ros_comm_msgs", "ros-noetic-std-srvs"),
    "tf2_msgs": ("geometry2", "ros-noetic-tf2-msgs"),
    "visualization_msgs": ("common_msgs", "ros-noetic-visualization-msgs"),
}

#: What ros-noetic-ros-core brings, or what comes with it: scripts/apt-packages.txt names ros-core.
WITH_ROS_CORE = {"genmsg", "genpy", "rosgraph", "roslaunch", "roslib", "rosunit"}
#: What scripts/requirements.txt installs instead, or what rospy brings.
ELSEWHERE = {"python3-pytest", "python3-rospkg"}


LARGE = {"Pillow>=7.0", "cryptography>=2.8", "matplotlib>=3.1"}
"""What the manifest wants and pip has in extras: a quarter of the disk space, for a few verbs."""


def keys(*tags):
    return {element.text for element in MANIFEST if element.tag in tags}


def all_keys():
    return {element.text for element in MANIFEST if element.tag.endswith("depend")}


def apt_packages(column):
    """Return the packages of scripts/apt-packages.txt: 0 for Debian 12, 1 for Ubuntu 20.04."""
    names = set()
    for line in (ROOT / "scripts/apt-packages.txt").read_text("utf-8").splitlines():
        words = line.split("#")[0].split()
        if words:
            names.add(words[min(column, len(words) - 1)])
    return names - {"-"}


def optional_requirements():
    """Return what scripts/requirements.txt installs that the package can do without."""
    text = (ROOT / "scripts/requirements.txt").read_text("utf-8")
    section = text.split("# --- used by the package where they are there\n")[1].split("# ---")[0]
    return {normal(line.split("#")[0]) for line in section.splitlines()} - {""}


def normal(requirement):
    return requirement.replace(" ", "").replace('"', "'")


def setup_py(monkeypatch, name="__main__"):
    """Run setup.py as pip does, or under another name as catkin does; return what it hands to
    setuptools."""
    given = {}
    monkeypatch.chdir(ROOT)
    monkeypatch.delenv("CATKIN_BINARY_DIR", raising=False)
    monkeypatch.setattr("setuptools.setup", lambda **words: given.update(words))
    runpy.run_path("setup.py", run_name=name)
    return given


def test_rosdep_defines_every_key_of_the_manifest():
    assert all_keys() == set(ROSDEP)


def test_rosdep_installs_what_run_demo_installs_on_ubuntu():
    needed = {ROSDEP[key][1] for key in all_keys() - WITH_ROS_CORE - ELSEWHERE}
    assert needed <= apt_packages(1)


def test_the_manifest_names_what_node_tests_import():
    imported = set()
    for path in (ROOT / "test/rostest").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Import):
                imported.update(alias.name.split(".")[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                imported.add(node.module.split(".")[0])
    packages = {
        name for name in imported if re.fullmatch(r"ros\w+|\w+_(msgs|srvs)|actionlib", name)
    }
    assert {"std_srvs", "rostest"} <= packages
    assert packages - {"robots"} <= all_keys()


def test_catkin_and_pip_read_one_version(monkeypatch):
    version = setup_py(monkeypatch)["version"]
    assert version == MANIFEST.findtext("version") == gspn_framework_package.__version__


def test_pip_knows_every_library_of_the_manifest(monkeypatch):
    needed = {key for key in keys("depend", "exec_depend") if key.startswith("python3-")}
    with_ros_only = {"python3-rospkg"}
    given = setup_py(monkeypatch)
    assert len({*given["install_requires"], *LARGE}) == len(needed - with_ros_only)
    assert LARGE.isdisjoint(given["install_requires"])


def test_the_extras_are_those_that_are_documented(monkeypatch):
    extras = setup_py(monkeypatch)["extras_require"]
    text = (ROOT / "docs/installing.md").read_text("utf-8")
    assert set(re.findall(r"^\| `\[(\w+)\]`", text, re.MULTILINE)) == set(extras)
    assert set(EXTRAS.values()) <= set(extras)  # which error messages name


def test_the_extras_want_the_versions_that_the_tests_run_with(monkeypatch):
    extras = setup_py(monkeypatch)["extras_require"]
    wanted = {normal(line) for lines in extras.values() for line in lines}
    assert wanted > LARGE
    assert (wanted - LARGE) ^ optional_requirements() == {
        # the one for the NumPy of Ubuntu 20.04, and the one for the NumPy that pip chooses
        "numba>=0.54,<0.55;python_version<'3.9'",
        "numba>=0.56,<0.59;python_version<'3.9'",
    }


def test_a_source_distribution_holds_what_setup_py_reads(monkeypatch):
    (share, files), (folder, documents) = setup_py(monkeypatch)["data_files"]
    assert files == ["package.xml"]
    assert (folder, documents) == (
        share + "/docs",
        sorted("docs/" + path.name for path in (ROOT / "docs").glob("*.md")),
    )


def test_pip_shows_what_the_package_is_and_installs_its_plans(monkeypatch):
    given = setup_py(monkeypatch)
    assert given["long_description"] == (ROOT / "README.md").read_text("utf-8")
    assert given["long_description_content_type"] == "text/markdown"
    assert {line.split(" :: ")[0] for line in given["classifiers"]} >= {"License", "Topic"}
    plans = given["package_data"]["gspn_framework_package.plans"]
    assert {"patrol/plan.json", "warehouse/plan.json"} <= set(plans)


@pytest.mark.parametrize("name", ["__main__", "catkin"])
def test_neither_experiments_nor_tests_are_installed(monkeypatch, name):
    """Here what setup.py and CMake are asked to install; scripts/check_install.sh looks into the
    wheel, the Debian package and the install space."""
    given = setup_py(monkeypatch, name)
    folders = [
        given["package_dir"].get(package, package.replace(".", "/"))
        for package in given["packages"]
    ]
    files = [file for names in given["package_data"].values() for file in names]
    files += [path.name for folder in folders for path in (ROOT / folder).glob("*.py")]
    assert {folder.split("/")[0] for folder in folders} <= {
        "gspn",
        "gspn_framework_package",
        "msg",
        "plans",
    }
    assert not [file for file in files if re.search(r"(^|/)(test_|conftest)|\.test$", file)]
    cmake = (ROOT / "CMakeLists.txt").read_text("utf-8")
    assert re.findall(r"foreach\(folder (.*)\)\n  install\(DIRECTORY", cmake) == ["launch plans"]
    assert cmake.count("install(DIRECTORY") == 1


# --- images and workflows: nothing here runs them


WORKFLOW = ROOT / ".github/workflows/tests.yml"
IMAGES = [WORKFLOW, ROOT / "Dockerfile", ROOT / ".devcontainer/devcontainer.json"]


def test_images_install_what_prepare_installs_and_name_no_package():
    for path in IMAGES:
        text = re.sub(r"#.*", "", path.read_text("utf-8"))
        assert re.search(r"scripts/prepare\.sh|\./run_tests|\.\./Dockerfile", text), path
        assert not re.search(r"\b(apt|apt-get|pip3?|rosdep) +(install|update)", text), path
        named = apt_packages(0) | apt_packages(1)
        assert set(re.findall(r"[\w.+-]+", text)) & named == set(), path


def test_the_workflow_tests_both_systems_and_builds_with_rosdep():
    jobs = yaml.safe_load(WORKFLOW.read_text("utf-8"))["jobs"]
    images = jobs["run_tests"]["strategy"]["matrix"]["image"]
    assert [step.get("run") for step in jobs["run_tests"]["steps"]][-1] == "./run_tests"
    assert {image.split(":")[0] for image in images} == {"debian", "ros"}
    assert jobs["industrial_ci"]["strategy"]["matrix"]["env"][0]["ROS_DISTRO"] == "noetic"
    dockerfile = (ROOT / "Dockerfile").read_text("utf-8")
    assert all(image in dockerfile for image in images)


def test_the_devcontainer_is_the_image():
    given = json.loads((ROOT / ".devcontainer/devcontainer.json").read_text("utf-8"))
    assert (ROOT / ".devcontainer" / given["build"]["dockerfile"]).resolve() == ROOT / "Dockerfile"


def test_the_citation_names_this_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert citation["version"] == gspn_framework_package.__version__
    assert citation["license"] == MANIFEST.findtext("license")
    assert citation["title"] == MANIFEST.findtext("name")
