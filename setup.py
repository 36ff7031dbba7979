"""What catkin installs of the Python package; read by catkin_make, not called by hand."""

import os

from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import find_packages, setup

PACKAGE = "gspn_framework_package"


def data_files():
    """Return every file of the package that is not Python code: schemas, the page, worlds."""
    found = []
    for folder, subfolders, names in os.walk(PACKAGE):
        subfolders[:] = [name for name in subfolders if name != "__pycache__"]
        for name in names:
            if not name.endswith((".py", ".pyc")):
                found.append(os.path.relpath(os.path.join(folder, name), PACKAGE))
    return sorted(found)


setup(
    **generate_distutils_setup(
        packages=find_packages(include=[PACKAGE, PACKAGE + ".*"]),
        package_dir={"": "."},
        package_data={PACKAGE: data_files()},
    )
)
