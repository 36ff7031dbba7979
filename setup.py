"""How the Python package is installed: by catkin_make into a workspace, and by pip where there is
no ROS."""

import glob
import os
import xml.etree.ElementTree as ElementTree

from setuptools import find_packages, setup

PACKAGE = "gspn_framework_package"
INTERFACE = "gspn"
"""The package for those who use it from Python."""

LIBRARIES = {
    "python3-flask": "Flask>=1.1",
    "python3-jsonschema": "jsonschema>=3.2",
    "python3-lxml": "lxml>=4.5",
    "python3-numpy": "numpy>=1.17",
    "python3-psutil": "psutil>=5.5",
    "python3-scipy": "scipy>=1.3",
    "python3-waitress": "waitress>=1.4",
    "python3-yaml": "PyYAML>=5.3",
}
"""rosdep key -> what pip calls it. Those of the manifest that are not here are in an extra."""

ZENOH = [
    "cryptography>=2.8",
    "eclipse-zenoh>=1.7,<2 ; python_version >= '3.9'",
    "eclipse-zenoh>=1.5,<1.6 ; python_version < '3.9'",
]

EXTRAS = {
    "bags": ["mcap>=1.1,<2", "rosbags>=0.9.20,<0.12"],
    "dask": [
        "distributed>=2022.12,<2026 ; python_version >= '3.9'",
        "distributed>=2021.4,<2021.9 ; python_version < '3.9'",
        "dask>=2021.4,<2021.9 ; python_version < '3.9'",
    ],
    "fast": [
        "numba>=0.56,<1 ; python_version >= '3.9'",
        "numba>=0.56,<0.59 ; python_version < '3.9'",
    ],
    "history": [
        "duckdb>=1.2,<3 ; python_version >= '3.9'",
        "duckdb>=1.1,<1.2 ; python_version < '3.9'",
    ],
    "plots": ["matplotlib>=3.1"],
    "proofs": ["z3-solver>=4.12,<6"],
    "symmetry": ["igraph>=0.10,<2"],
    "team": ZENOH,  # agents and their operator, without ROS
    "world": [
        "Pillow>=7.0",
        "imageio-ffmpeg>=0.4,<1",
        "pybullet>=3.2,<4 ; python_version >= '3.9'",
        "pybullet>=3.2,<3.2.6 ; python_version < '3.9'",
    ],
    "zenoh": ZENOH,
}
"""What a user may want besides -> what it needs: the versions of scripts/requirements.txt, except
that pip need not take the numba of Ubuntu 20.04's NumPy, with which the newest Pillow fails."""


def files_below(top, leave_out=()):
    """Return the files below a folder, relative to it, but for those that end in ``leave_out``."""
    found = []
    for folder, subfolders, names in os.walk(top):
        subfolders[:] = [name for name in subfolders if name not in ("__pycache__", "runs")]
        for name in names:
            if not name.endswith(leave_out):
                found.append(os.path.relpath(os.path.join(folder, name), top))
    return sorted(found)


def for_pip(manifest):
    """Return what pip wants to know beyond what catkin does. ROS itself does not come from pip, and
    is not needed for what the package does without it."""
    named = [element.text for element in manifest.findall("exec_depend")]
    return {
        "long_description": open("README.md", encoding="utf-8").read(),
        "long_description_content_type": "text/markdown",
        "keywords": "petri-nets gspn robotics multi-robot ros planning model-checking",
        "classifiers": [
            "Development Status :: 4 - Beta",
            "Intended Audience :: Science/Research",
            "Intended Audience :: Developers",
            "License :: OSI Approved :: BSD License",
            "Operating System :: POSIX :: Linux",
            "Programming Language :: Python :: 3",
            "Programming Language :: Python :: 3.8",
            "Programming Language :: Python :: 3.11",
            "Topic :: Scientific/Engineering",
            "Topic :: Scientific/Engineering :: Artificial Intelligence",
        ],
        "python_requires": ">=3.8",
        "install_requires": [LIBRARIES[key] for key in named if key in LIBRARIES],
        "extras_require": EXTRAS,
        "data_files": [
            # this file reads package.xml where pip has unpacked a source distribution, too
            ("share/" + PACKAGE, ["package.xml"]),
            ("share/" + PACKAGE + "/docs", sorted(glob.glob("docs/*.md"))),
        ],
        "entry_points": {"console_scripts": ["gspn = %s.cli.main:main" % PACKAGE]},
    }


def packages(by_catkin):
    """Return what is installed. pip also installs the definitions of the messages and the example
    plans, which catkin installs as ROS does."""
    found = {
        "packages": find_packages(include=[INTERFACE, PACKAGE, PACKAGE + ".*"]),
        "package_dir": {"": "."},
        "package_data": {name: files_below(name, (".py", ".pyc")) for name in (INTERFACE, PACKAGE)},
    }
    if not by_catkin:
        for name, folder in (("msg_files", "msg"), ("plans", "plans")):
            found["packages"].append(PACKAGE + "." + name)
            found["package_dir"][PACKAGE + "." + name] = folder
            found["package_data"][PACKAGE + "." + name] = files_below(folder)
    return found


manifest = ElementTree.parse("package.xml").getroot()
# catkin asks this file what there is by running it under another name, and tells where it installs
# to
by_catkin = __name__ != "__main__" or "CATKIN_BINARY_DIR" in os.environ
setup(
    name=PACKAGE,
    version=manifest.findtext("version"),
    description=" ".join(manifest.findtext("description").split()),
    maintainer=manifest.findtext("maintainer"),
    maintainer_email=manifest.find("maintainer").get("email"),
    license=manifest.findtext("license"),
    **({} if by_catkin else for_pip(manifest)),
    **packages(by_catkin),
)
