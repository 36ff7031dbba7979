"""Settings of Sphinx; ``docs/build`` makes the pages."""

import pkgutil
import sys
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parent
sys.path[:0] = [str(ROOT), str(HERE)]

import notebook_pages  # noqa: E402

import gspn_framework_package  # noqa: E402

project = "gspn_framework_package"
author = "gspn_framework_package developers"
copyright = author
release = version = gspn_framework_package.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["_build", "_templates"]
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
# names such as Step that two layers have
suppress_warnings = ["ref.python"]

html_theme = "furo"
html_title = "gspn_framework_package " + release
html_copy_source = False
templates_path = ["_templates"]
html_sidebars = {
    "**": [
        "sidebar/brand.html",
        "sidebar/search.html",
        "versions.html",
        "sidebar/scroll-start.html",
        "sidebar/navigation.html",
        "sidebar/scroll-end.html",
    ]
}

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
# Pages are built without ROS, PyBullet and a browser too.
autodoc_mock_imports = [
    "actionlib",
    "actionlib_msgs",
    "diagnostic_msgs",
    "genpy",
    "geometry_msgs",
    "nav_msgs",
    "numba",
    "pybullet",
    "pybullet_utils",
    "rosbag",
    "rosgraph",
    "rosgraph_msgs",
    "roslaunch",
    "roslib",
    "rosnode",
    "rospkg",
    "rospy",
    "rosservice",
    "rostopic",
    "sensor_msgs",
    "std_msgs",
    "std_srvs",
    "tf2_msgs",
    "tf2_ros",
    "gspn_framework_package.msg",
    "gspn_framework_package.srv",
]

LAYERS = {
    "model": "Nets, markings, policies, plans, errors. Immutable; no input or output, no ROS.",
    "formats": "Readers and writers: each file format to and from the model.",
    "run_net": "What a plan means while it runs, compiled once.",
    "analysis": "Structure, state spaces, Markov chains: model in, result objects out.",
    "execution": "The token game, the event log, the agreement among robots, the standalone "
    "executor.",
    "making": "New plans, from templates, maps and behaviour trees.",
    "testing": "Tests of plans, in virtual time.",
    "fleet": "Months of logs as tables, and reports on them.",
    "team": "The host of a robot's replica, and what carries its messages.",
    "ros": "Thin adapters between the core and ROS.",
    "visualizer": "The page.",
    "world": "The simulated room.",
}


def write_api_pages() -> None:
    """One page for each layer, with all of its modules: a new one is never forgotten."""
    folder = HERE / "api"
    folder.mkdir(exist_ok=True)
    for layer, summary in LAYERS.items():
        path = ROOT / "gspn_framework_package" / layer
        prefix = "gspn_framework_package.%s." % layer
        names = sorted(m.name for m in pkgutil.walk_packages([str(path)], prefix))
        title = "gspn_framework_package." + layer
        lines = [title, "=" * len(title), "", summary, ""]
        for name in names:
            short = name[len(prefix) :]
            lines += [short, "-" * len(short), "", ".. automodule:: " + name]
            lines += ["   :members:", "   :show-inheritance:", ""]
        text = "\n".join(lines)
        page = folder / (layer + ".rst")
        if not page.exists() or page.read_text(encoding="utf-8") != text:
            page.write_text(text, encoding="utf-8")


write_api_pages()
notebook_pages.write_pages()
