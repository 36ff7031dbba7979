"""The package as a whole: its layers, its syntax, its manifest, its command line."""

import ast
import itertools
import json
import os
import re
import signal
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from functools import lru_cache
from pathlib import Path

import pytest
from waiting import PATIENCE

import gspn_framework_package
from gspn_framework_package.analysis.simulation import kernel
from gspn_framework_package.cli import main as dispatcher
from gspn_framework_package.execution import turn
from gspn_framework_package.model.errors import GspnError, InputError
from gspn_framework_package.model.outcome import Outcome

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "gspn_framework_package"
INTERFACE = ROOT / "gspn"
MODULES = [*sorted(PACKAGE.rglob("*.py")), *sorted(INTERFACE.rglob("*.py"))]
#: Programs for rosrun and roslaunch; the other files in scripts/ have a suffix.
PROGRAMS = sorted(
    path
    for path in (ROOT / "scripts").iterdir()
    if path.is_file()
    and not path.suffix
    and path.name not in ("make_deb", "check_spec")  # of the checkout
)
SCRIPTS = [ROOT / "setup.py", *PROGRAMS, *sorted((ROOT / "scripts").glob("*.py"))]
PLANS = sorted((ROOT / "plans").rglob("*.py"))
TESTS = sorted((ROOT / "test").rglob("*.py"))

#: The layers, each with a number: a module may import only from its own layer and from those with
#: a lower number. Those of the outer shell have numbers in the order in which they build on
#: each other: the command line may start anything, nothing starts it.
LAYERS = {
    "model": 0,
    "formats": 1,
    "run_net": 1,
    "analysis": 2,
    "making": 2,
    "execution": 3,
    "fleet": 4,
    "testing": 4,
    "team": 4,
    "ros": 5,
    "visualizer": 6,
    "world": 6,
    "cli": 7,
}
INNER = [layer for layer, number in LAYERS.items() if number <= 4]

#: What no inner module may import: ROS, and the generated messages of this package.
ROS = re.compile(
    r"(rospy|roslib|roslaunch|rosgraph|rosbag|genpy|actionlib|tf2_ros|\w+_msgs|std_srvs)(\.|$)"
    r"|gspn_framework_package\.(msg|srv)(\.|$)"
)

#: Libraries that the package does without: only the modules that use them fail to import.
OPTIONAL = ["duckdb", "igraph", "numba"]

#: What the package imports that is not Python's own nor a ROS package of that name -> its rosdep
#: key, "" for what the package does without.
ROSDEP_KEYS = {
    "PIL": "python3-pil",
    "cryptography": "python3-cryptography",
    "duckdb": "",
    "igraph": "",
    "flask": "python3-flask",
    "gazebo_msgs": "",  # Debian has none
    "imageio_ffmpeg": "",
    "jsonschema": "python3-jsonschema",
    "llvmlite": "",
    "lxml": "python3-lxml",
    "matplotlib": "python3-matplotlib",
    "distributed": "",
    "numba": "",
    "numpy": "python3-numpy",
    "pandas": "",
    "playwright": "",
    "psutil": "python3-psutil",
    "pybullet": "",
    "pybullet_utils": "",
    "rospkg": "python3-rospkg",
    "scipy": "python3-scipy",
    "stormpy": "",
    "waitress": "python3-waitress",
    "werkzeug": "python3-flask",  # Flask is built on it
    "yaml": "python3-yaml",
    "z3": "",
    "mcap": "",
    "rosbags": "",
    "zenoh": "",
}


def name_of(path):
    parts = list(path.relative_to(ROOT).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def layer_of(name):
    """Return the layer that a module of the package is in; None: the package itself."""
    parts = name.split(".")
    return parts[1] if len(parts) > 1 and parts[1] in LAYERS else None


@lru_cache(maxsize=None)
def imports_of(path, source=None):
    """Return the full names of the modules that a file imports, wherever in the file. Several tests ask
    for those of every module."""
    package = name_of(path) if path.name == "__init__.py" else name_of(path).rpartition(".")[0]
    names = []
    for node in ast.walk(ast.parse(source if source is not None else path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                outer = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join(outer + ([base] if base else []))
            names += [base] + ["{}.{}".format(base, alias.name) for alias in node.names]
    return names


def outward_imports(path, source=None):
    """Return the imports of a module that its layer forbids."""
    own = layer_of(name_of(path))
    if own is None:
        return []
    forbidden = []
    for name in imports_of(path, source):
        other = layer_of(name) if name.startswith(PACKAGE.name + ".") else None
        if other is not None and LAYERS[other] > LAYERS[own] or own in INNER and ROS.match(name):
            forbidden.append(name)
    return forbidden


def clean_environment():
    """Return the environment of a user in a bare checkout: no ROS sourced."""
    return {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("ROS", "CMAKE", "PYTHON", "GSPN_DEBUG"))
    }


def gspn(*words, start=("-m", PACKAGE.name)):
    """Run the command line as a user does in a bare checkout."""
    return subprocess.run(
        [sys.executable, *start, *words],
        cwd=str(ROOT),
        env=clean_environment(),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=60 * PATIENCE,
    )


def gspn_importing(*words):
    """Run the command line; return what it did, and the names of all modules that it imported."""
    code = (
        "import sys; from {}.cli.main import main; code = main(sys.argv[1:]); "
        "print(*sys.modules, file=sys.stderr); sys.exit(code)"
    )
    ran = gspn(*words, start=("-c", code.format(PACKAGE.name)))
    return ran, ran.stderr.split()


# --- layers


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_a_module_imports_only_inner_layers(path):
    assert outward_imports(path) == []


@pytest.mark.parametrize(
    "module, line",
    [
        ("model/net.py", "from gspn_framework_package.formats import pipe"),
        ("model/net.py", "from ..execution import token_game"),
        ("model/__init__.py", "from ..execution import token_game"),
        ("execution/token_game.py", "def f():\n    import rospy"),
        ("analysis/graph.py", "from std_msgs.msg import Header"),
        ("formats/pipe.py", "from gspn_framework_package import ros"),
        ("ros/node.py", "import gspn_framework_package.visualizer.server"),
    ],
)
def test_the_layer_check_sees_an_outward_import(module, line):
    assert outward_imports(PACKAGE / module, line)


@pytest.mark.parametrize(
    "module, line",
    [
        ("formats/pipe.py", "from ..model.net import Net"),
        ("ros/node.py", "import rospy\nfrom gspn_framework_package.msg import FiredTransition"),
        ("execution/log.py", "from . import entries"),
    ],
)
def test_the_layer_check_lets_inward_imports_pass(module, line):
    assert outward_imports(PACKAGE / module, line) == []


@pytest.mark.parametrize(
    "folder", sorted({path.parent for path in MODULES}), ids=lambda p: str(p.relative_to(ROOT))
)
def test_the_docstring_of_a_folder_names_what_is_in_it(folder):
    said = ast.get_docstring(ast.parse((folder / "__init__.py").read_text("utf-8")))
    there = {path.stem for path in folder.glob("*.py")} - {"__init__", "__main__"}
    there |= {path.parent.name for path in folder.glob("*/__init__.py")}
    assert there <= set(re.findall(r"``(\w+)``", said))


REFERENCE = re.compile(r":(?:mod|class|func|meth|data|attr|exc):`~?([^`<]+)`")


PAGE = PACKAGE / "visualizer" / "static" / "js"
SCRIPTS_OF_THE_PAGE = sorted(PAGE.rglob("*.js"))

LONGEST_FILE, LONGEST_FUNCTION = 600, 80  # lines
REASON = re.compile(r" *(#|//) In one piece: \w.{20,}")


def too_long(path):
    """Return what of a file is longer than that without a reason at its head: a comment line "In one
    piece: WHY" above the first code of the file, or above the function."""
    text = path.read_text("utf-8")
    lines = text.splitlines()

    def has_reason(first):
        before = itertools.takewhile(
            lambda line: line.strip()[:1] in ("#", "/") or not line.strip(), lines[first::-1]
        )
        return any(REASON.fullmatch(line) for line in before)

    if path.suffix == ".js":
        code = next((n for n, line in enumerate(lines) if line.strip()[:2] not in ("//", "")), 0)
        return [] if len(lines) <= LONGEST_FILE or has_reason(code - 1) else [path.name]
    tree = ast.parse(text)
    code = tree.body[1 if ast.get_docstring(tree) is not None else 0 :]
    found = []
    if len(lines) > LONGEST_FILE and code and not has_reason(code[0].lineno - 2):
        found.append(path.name)
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            first = min([node.lineno, *(each.lineno for each in node.decorator_list)])
            if node.end_lineno - first >= LONGEST_FUNCTION and not has_reason(first - 2):
                found.append("%s: %s" % (path.name, node.name))
    return found


@pytest.mark.long
def test_what_is_long_has_a_reason():
    assert [name for path in MODULES + SCRIPTS_OF_THE_PAGE for name in too_long(path)] == []


WHY = " In one piece: what it holds belongs together\n"


@pytest.mark.parametrize(
    "name, text, found",
    [
        ("a.py", '"""Doc."""\n\nx = 1\n' + "\n" * 597, []),
        ("a.py", '"""Doc."""\n\nx = 1\n' + "\n" * 598, ["a.py"]),
        ("a.py", '"""Doc."""\n\n#' + WHY + "\nx = 1\n" + "\n" * 598, []),
        ("a.py", '"""Doc."""\n\nx = 1\n#' + WHY + "\n" * 598, ["a.py"]),
        ("a.py", '"""Doc."""\n\n# In one piece: so\nx = 1\n' + "\n" * 598, ["a.py"]),
        ("a.py", "def f():\n" + "    x = 1\n" * 79, []),
        ("a.py", "def f():\n" + "    x = 1\n" * 80, ["a.py: f"]),
        ("a.py", "#" + WHY + "@g\ndef f():\n" + "    x = 1\n" * 80, []),
        ("a.js", "// Doc.\n\nx();\n" + "\n" * 598, ["a.js"]),
        ("a.js", "// Doc.\n//" + WHY + "\nx();\n" + "\n" * 598, []),
    ],
)
def test_the_check_of_lengths_sees_what_is_too_long(tmp_path, name, text, found):
    (tmp_path / name).write_text(text)
    assert too_long(tmp_path / name) == found


@lru_cache(maxsize=1)
def defined():
    """Module -> the names that it defines or imports, those in classes as CLASS.NAME too."""
    found = {}
    for path in MODULES:
        names = found.setdefault(name_of(path), set())
        owners = [("", ast.parse(path.read_text("utf-8")))]
        while owners:
            owner, tree = owners.pop()
            for node in ast.walk(tree):
                if isinstance(node, ast.ClassDef) and node is not tree:
                    owners.append((node.name + ".", node))
                if isinstance(node, (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
                    names.update({node.name, owner + node.name})
                elif isinstance(node, (ast.Import, ast.ImportFrom)):
                    names.update((a.asname or a.name).split(".")[0] for a in node.names)
                elif isinstance(getattr(node, "ctx", None), ast.Store):
                    name = getattr(node, "id", None) or getattr(node, "attr", "")
                    names.update({name, owner + name})
    return found


def is_defined(reference, module):
    """Whether a reference in a docstring of a module leads somewhere: relative to the module or its
    package, absolute, by the end of a module's name after a dot, or to a class, whose name is
    unique."""
    known, name = defined(), reference.strip().rstrip("()").lstrip(".")
    if name in known[module] or any(
        name.split(".")[0][:1].isupper() and name in names for names in known.values()
    ):
        return True
    parts = name.split(".")
    for cut in range(1, len(parts) + 1):
        begin, rest = ".".join(parts[:cut]), ".".join(parts[cut:])
        package = module.rpartition(".")[0]
        for other in (begin, package + "." + begin, module + "." + begin):
            if other in known and (not rest or rest in known[other]):
                return True
        if reference.startswith("."):
            ends = [m for m in known if m.endswith("." + begin)]
            if any(not rest or rest in known[m] for m in ends):
                return True
    return False


@pytest.mark.long
def test_references_in_docstrings_lead_somewhere():
    lost = [
        "%s: %s" % (name_of(path), reference)
        for path in MODULES
        for reference in REFERENCE.findall(path.read_text("utf-8"))
        if not is_defined(reference, name_of(path))
    ]
    assert lost == []


#: Public names that several modules bind, with the reason; no other name is bound twice.
BOUND_TWICE = {
    "Net": "the stable one of gspn has the model's",
    "Plan": "the stable one of gspn has the model's",
    "EPILOG": "a verb of the table in cli/main.py has it",
    "FIRINGS_PER_ENTRY": "the kernel imports nothing: numba caches it by its own file alone",
    "OPTIONS": "a verb of the table in cli/main.py has it",
    "add_arguments": "a verb of the table in cli/main.py has it, or gives OPTIONS",
    "add_routes": "each module of routes has it",
    "explore": "each engine has it, and state_space/space.py, which chooses among them",
    "from_xml": "the reader of a format of XML",
    "losses": "what the writer of a format leaves out",
    "main": "the module is a program",
    "run": "a verb of the table in cli/main.py has it",
    "to_bytes": "the writer of a format",
    "update": "the editor's writer of a format",
}


def public_names(tree):
    """The names that a module binds for others: its classes, functions, constants, type aliases.
    What it imports is bound elsewhere."""
    for node in tree.body:
        if isinstance(node, (ast.ClassDef, ast.FunctionDef)):
            names = [node.name]
        elif isinstance(node, (ast.Assign, ast.AnnAssign)):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = [n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)]
        elif isinstance(node, (ast.If, ast.Try, ast.With)):
            yield from public_names(node)
            continue
        else:
            continue
        yield from (name for name in names if not name.startswith("_"))


@pytest.mark.long
def test_no_public_name_is_bound_in_two_modules():
    homes = {}
    for path in MODULES:
        for name in set(public_names(ast.parse(path.read_text("utf-8")))):
            homes.setdefault(name, []).append(name_of(path))
    twice = {name: places for name, places in homes.items() if len(places) > 1}
    assert {n: places for n, places in twice.items() if n not in BOUND_TWICE} == {}
    assert set(BOUND_TWICE) <= set(twice), "no longer bound twice"


@pytest.mark.long
def test_an_outcome_of_an_action_is_written_in_one_place():
    words = {outcome.value for outcome in Outcome} - {
        "lost",
        "timeout",
    }  # which other things are too
    written = {
        name_of(path)
        for path in MODULES
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Constant) and node.value in words
    }
    assert written == {PACKAGE.name + ".model.outcome"}


def test_the_schema_names_outcomes():
    schema = json.loads((PACKAGE / "formats" / "plan.schema.json").read_text("utf-8"))
    named = schema["definitions"]["outcomes"]["propertyNames"]["enum"]
    assert set(named) <= {outcome.value for outcome in Outcome}


def test_the_kernel_has_the_limit_of_a_run():
    assert kernel.FIRINGS_PER_ENTRY == turn.FIRINGS_PER_ENTRY


def cycles(imported):
    """Return those that import themselves, in one or more steps. ``imported``: of each."""
    reached = {name: set(names) for name, names in imported.items()}
    for between in imported:  # Warshall's algorithm
        for name in imported:
            if between in reached[name]:
                reached[name] |= reached[between]
    return [name for name in imported if name in reached[name]]


@pytest.mark.long
def test_no_two_modules_import_each_other():
    modules = {name_of(path): path for path in MODULES if path.name != "__init__.py"}
    imported = {name: modules.keys() & set(imports_of(path)) for name, path in modules.items()}
    assert cycles(imported) == []


def imports_of_scripts():
    """Script of the page -> those that come with it; an ``import()`` loads one later."""
    imports = re.compile(r"""^(?:import|export)\b[^;]*?["'](\.[^"']+)["'];""", re.MULTILINE)
    return {
        path: {(path.parent / name).resolve() for name in imports.findall(path.read_text("utf-8"))}
        for path in SCRIPTS_OF_THE_PAGE
    }


def test_no_two_scripts_of_the_page_import_each_other():
    imported = imports_of_scripts()
    assert imported[PAGE / "edit" / "plan_panel.js"] == {
        PAGE / "edit" / "property_panel.js",
        PAGE / "edit" / "schema_form.js",
    }
    assert cycles(imported) == []


def test_the_style_of_the_page_keeps_to_a_grid_and_two_weights():
    """Distances are multiples of 4 px; up to 2 px are the edge of something."""
    for path in (PAGE.parent / "css").glob("*.css"):
        text = path.read_text("utf-8")
        for rule in re.findall(r"\b(?:padding|margin|gap)[a-z-]*:[^;}]+", text):
            for size in re.findall(r"([\d.]+)px", rule):
                assert float(size) <= 2 or float(size) % 4 == 0, "%s: %s" % (path.name, rule)
        weights = re.findall(r"font(?:-weight)?: ?(\d00)\b", text)
        assert set(weights) <= {"400", "600"}, (path.name, weights)


def test_who_does_not_edit_loads_no_part_of_the_editor():
    imported, reached, ahead = imports_of_scripts(), set(), {PAGE / "main.js"}
    while ahead:
        reached |= ahead
        ahead = set().union(*(imported[path] for path in ahead)) - reached
    assert PAGE / "edit" / "editor.js" in reached
    assert not {PAGE / "edit" / name for name in ("mode.js", "files.js", "form.js")} & reached


#: Services, topics and parameters of the nodes. A layout of Foxglove shows topics.
NAMES_ON_ROS = re.compile(
    r"\b(get_state|get_place|fired_transitions|gspn_agreement|robot_activity)\b|[^.]/diagnostics\b"
    r"|\"~[a-z_]+\""
)


def test_the_core_names_no_service_or_topic_of_the_nodes():
    named = [
        name_of(path)
        for path in MODULES
        if layer_of(name_of(path)) in INNER and NAMES_ON_ROS.search(path.read_text("utf-8"))
    ]
    assert named == [PACKAGE.name + ".formats.foxglove"]


def test_every_folder_of_the_package_is_a_layer():
    folders = {path.parent.relative_to(PACKAGE).parts[0] for path in PACKAGE.glob("*/__init__.py")}
    assert folders <= set(LAYERS)


#: What rospy calls its own: a module that is not documented, a name that begins with "_".
INTERNALS_OF_ROSPY = re.compile(
    r"\brospy\.(impl|topics)\b|\brospy(\.\w+)*\._[a-z]|\brospy import _"
)


def test_only_the_transport_touches_the_internals_of_rospy():
    touching = [
        path
        for path in MODULES + PROGRAMS
        if INTERNALS_OF_ROSPY.search(path.read_text(encoding="utf-8"))
    ]
    assert touching
    assert {path.parent for path in touching} == {PACKAGE / "ros" / "transport"}


MAP = (ROOT / "docs" / "developing.md").read_text("utf-8")


@pytest.mark.long
def test_the_drawing_of_the_layers_agrees_with_the_imports():
    drawn = {
        layer: set(below.split())
        for layer, below in re.findall(r"^(\w+) +-> ?(.*)$", MAP, re.MULTILINE)
    }
    imported = {layer: set() for layer in LAYERS}
    for path in MODULES:
        own = layer_of(name_of(path))
        if own is not None:
            names = [n for n in imports_of(path) if n.startswith(PACKAGE.name + ".")]
            imported[own].update({layer_of(name) for name in names} - {own, None})
    assert drawn == imported


def test_every_file_on_the_map_is_there():
    named = set(re.findall(r"`([\w./]+\.(?:py|js|json|md|txt|xml|rst)|\w+/[\w/]+)`", MAP))
    assert len(named) > 80
    absent = [n for n in named if not (ROOT / n).exists() and not (PACKAGE / n).exists()]
    assert absent == [], "docs/developing.md names files that are not there (any more)"


@pytest.mark.long
@pytest.mark.parametrize("layer", INNER)
def test_importing_an_inner_layer_imports_no_ros(layer):
    if not (PACKAGE / layer).is_dir():
        pytest.fail("the layer {} is missing".format(layer))
    names = [name_of(path) for path in sorted((PACKAGE / layer).rglob("*.py"))]
    code = """
import importlib, sys
for name in {!r}:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name not in {!r}:
            raise
print(*sys.modules)
"""
    imported = subprocess.run(
        [sys.executable, "-c", code.format(names, OPTIONAL)],
        cwd=str(ROOT),
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        timeout=120 * PATIENCE,
    ).stdout.split()
    assert "{}.{}".format(PACKAGE.name, layer) in imported
    assert [name for name in imported if ROS.match(name)] == []


# --- syntax


@pytest.mark.parametrize(
    "path", MODULES + SCRIPTS + PLANS + TESTS, ids=lambda path: str(path.relative_to(ROOT))
)
def test_the_syntax_is_that_of_python_3_8(path):
    ast.parse(path.read_text("utf-8"), filename=str(path), feature_version=(3, 8))


@pytest.mark.parametrize(
    "code", ["match x:\n    case 1: pass", "with (open(a) as b, open(c)): pass"]
)
def test_the_syntax_check_refuses_newer_syntax(code):
    with pytest.raises(SyntaxError):
        ast.parse(code, feature_version=(3, 8))


# --- manifest


def test_version_and_license_agree_everywhere():
    manifest = ElementTree.parse(str(ROOT / "package.xml")).getroot()
    assert manifest.get("format") == "3"
    assert manifest.findtext("name") == PACKAGE.name
    assert manifest.findtext("version") == gspn_framework_package.__version__
    assert manifest.findtext("license") == "BSD-3-Clause"
    license_file = ROOT / manifest.find("license").get("file")
    assert license_file.read_text("utf-8").startswith("BSD 3-Clause")


@pytest.mark.skipif(
    sys.version_info < (3, 10), reason="Python does not say what its own modules are"
)
def test_the_manifest_names_all_that_the_package_imports():
    manifest = ElementTree.parse(str(ROOT / "package.xml")).getroot()
    named = {element.text for tag in ("depend", "exec_depend") for element in manifest.findall(tag)}
    imported = {name.split(".")[0] for path in MODULES for name in imports_of(path)}
    others = imported - set(sys.stdlib_module_names) - {PACKAGE.name, INTERFACE.name, ""}
    assert {ROSDEP_KEYS.get(name, name) for name in others} - {""} <= named


def test_every_interface_file_is_built():
    cmake = (ROOT / "CMakeLists.txt").read_text("utf-8")
    for folder in ("action", "msg", "srv"):
        for path in (ROOT / folder).iterdir():
            assert path.name in cmake


def test_every_program_is_installed():
    cmake = (ROOT / "CMakeLists.txt").read_text("utf-8")
    listed = re.search(r"set\(scripts ([^)]*)\)", cmake).group(1).split()
    assert sorted(listed) == sorted(path.name for path in PROGRAMS)


def test_the_action_keeps_the_fields_of_the_thesis():
    text = (ROOT / "action" / "ExecGSPN.action").read_text("utf-8")
    fields = [line.split("#")[0].split() for line in text.splitlines()]
    assert [" ".join(words) for words in fields if words] == [
        "string place",
        "---",
        "string transition",
        "---",
        "int32[] time_passed",
    ]


# --- command line


class Verb:
    """A verb for the tests below; does what the test asks for."""

    def __init__(self, outcome):
        self.outcome = outcome

    def add_arguments(self, parser):
        parser.add_argument("--number", type=int, default=0)

    def run(self, args):
        if isinstance(self.outcome, BaseException):
            raise self.outcome
        return self.outcome + args.number


@pytest.fixture
def verb(monkeypatch):
    """Returns a function that puts a verb with the given outcome into the command line."""

    def install(outcome):
        monkeypatch.setitem(dispatcher.VERBS, "verb", dispatcher.Verb("a_verb", "does as told"))
        monkeypatch.setitem(sys.modules, "a_verb", Verb(outcome))
        monkeypatch.delenv("GSPN_DEBUG", raising=False)

    return install


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(dispatcher.all_verbs()))
def test_a_verb_is_what_the_table_says(name, capsys):
    assert dispatcher.main([name, "--help"]) == 0
    words = " ".join(capsys.readouterr().out.split())
    assert words.startswith("usage: gspn " + name)
    assert dispatcher.all_verbs()[name].help in words
    example = dispatcher.all_verbs()[name].example
    assert example.split()[0] == name and words.endswith("Example: gspn " + example)
    dispatcher._parser(example.split()).parse_args(example.split())


def test_help_lists_every_verb_and_imports_none():
    shown, imported = gspn_importing("--help")
    assert shown.returncode == 0
    for name in dispatcher.all_verbs():
        assert re.search(r"^  {}\b".format(re.escape(name)), shown.stdout, re.MULTILINE)
    modules = [verb.module for verb in dispatcher.VERBS.values()]
    assert ".check" in modules
    for module in modules:
        assert "gspn_framework_package.cli" + module not in imported


def test_a_check_imports_only_what_it_needs():
    checked, imported = gspn_importing("check", "plans/measure")
    assert checked.returncode == 0
    own = {name for name in imported if name.split(".")[0] == PACKAGE.name}
    assert PACKAGE.name + ".formats.pipe" in own
    # what explores is imported when the structure leaves a question open
    assert "numpy" not in imported
    assert not any(".state_space" in name or name.endswith(".siphons") for name in own)
    assert len(own) <= 60, sorted(own)


@pytest.mark.long
def test_a_check_that_visits_all_markings_imports_no_solver():
    checked, imported = gspn_importing("check", "plans/rendezvous")
    assert checked.returncode == 0
    assert PACKAGE.name + ".analysis.preflight.markings" in imported
    assert "scipy.optimize" not in imported


def test_version():
    shown = gspn("--version")
    assert (shown.returncode, shown.stdout.split()) == (
        0,
        ["gspn", gspn_framework_package.__version__],
    )


def test_a_misspelt_verb_is_answered_with_the_one_that_was_meant():
    shown = gspn("analyze", "net.xml")
    assert (shown.returncode, shown.stdout) == (2, "")
    assert shown.stderr == "gspn: error: there is no verb 'analyze' (did you mean analyse?)\n"


@pytest.mark.long
@pytest.mark.parametrize("words", [[], ["no-such-verb"], ["--no-such-option"]])
def test_wrong_usage_exits_with_2_and_says_why(words):
    shown = gspn(*words)
    assert shown.returncode == 2
    assert shown.stdout == ""
    assert "gspn: error: " in shown.stderr
    assert "Traceback" not in shown.stderr


@pytest.mark.parametrize("code", [0, 1, 2])
def test_the_exit_code_is_that_of_the_verb(verb, code):
    verb(code)
    assert dispatcher.main(["verb"]) == code


def test_arguments_reach_the_verb(verb):
    verb(0)
    assert dispatcher.main(["verb", "--number", "1"]) == 1
    assert dispatcher.main(["--debug", "verb", "--number=2"]) == 2


@pytest.mark.parametrize(
    "outcome, code, message",
    [
        (InputError("no place p", file="a.json", line=3), 2, "gspn: error: a.json:3: no place p"),
        (FileNotFoundError(2, "No such file", "b.json"), 2, "gspn: error: b.json: No such file"),
        (
            ModuleNotFoundError("No module named 'lxml'", name="lxml"),
            2,
            "gspn: error: %s has no Python library 'lxml' (pip install lxml)" % sys.executable,
        ),
        (
            ModuleNotFoundError("No module named 'x'", name="gspn_framework_package.x"),
            70,
            "gspn: internal error: ModuleNotFoundError: No module named 'x'",
        ),
        (KeyboardInterrupt(), 130, "gspn: interrupted"),
        (KeyError("x"), 70, "gspn: internal error: KeyError: 'x'"),
        (RecursionError("too deep"), 70, "gspn: internal error: RecursionError: too deep"),
    ],
)
def test_an_exception_is_one_message_and_an_exit_code(verb, capsys, outcome, code, message):
    verb(outcome)
    assert dispatcher.main(["verb"]) == code
    output, errors = capsys.readouterr()
    assert output == ""
    assert errors.splitlines()[0] == message
    assert "Traceback" not in errors


# As a compiled module does that is interrupted while it imports another, or calls back.
INTERRUPTED = """
import ctypes, os, signal, sys

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell ignores it in the background

def interrupted():
    os.kill(os.getpid(), signal.SIGINT)
    while True:  # until the signal is there
        pass

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "library":
            try:
                interrupted()
            except KeyboardInterrupt:
                raise ImportError("library failed to import")

sys.meta_path.insert(0, Finder())
from gspn_framework_package.cli import main, verify
main.VERBS["verb"] = main.Verb("verb", "")
sys.modules["verb"] = verify
callback = ctypes.CFUNCTYPE(None)(interrupted)
verify.run = lambda args: callback() if sys.argv[1] == "callback" else __import__("library")
verify.add_arguments = lambda parser: __import__("library") if sys.argv[1] == "early" else None
sys.exit(main.main(["verb"]))
"""


@pytest.mark.long
@pytest.mark.parametrize("when", ["early", "late", "callback"])
def test_an_interrupt_in_a_library_is_neither_a_fault_nor_lost(when):
    process = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, when],
        cwd=str(ROOT),
        env=clean_environment(),
        stderr=subprocess.PIPE,
        timeout=60 * PATIENCE,
    )
    assert (process.returncode, process.stderr) == (130, b"gspn: interrupted\n")


def test_the_handler_of_interrupts_is_put_back(verb):
    before = signal.getsignal(signal.SIGINT)
    verb(0)
    dispatcher.main(["verb"])
    assert signal.getsignal(signal.SIGINT) is before


def test_an_error_with_another_exit_code_keeps_it(verb):
    error = GspnError("refused")
    error.exit_code = 1
    verb(error)
    assert dispatcher.main(["verb"]) == 1


@pytest.mark.parametrize("how", ["option", "variable"])
def test_debug_adds_the_traceback(verb, capsys, monkeypatch, how):
    verb(KeyError("x"))
    if how == "variable":
        monkeypatch.setenv("GSPN_DEBUG", "1")
    assert dispatcher.main(["verb", "--debug"] if how == "option" else ["verb"]) == 70
    assert "Traceback" in capsys.readouterr().err


def test_a_reader_that_leaves_gets_no_complaint():
    reading, writing = os.pipe()
    os.close(reading)
    try:
        process = subprocess.run(
            [sys.executable, "-m", PACKAGE.name, "--help"],
            cwd=str(ROOT),
            env=clean_environment(),
            stdout=writing,
            stderr=subprocess.PIPE,
            timeout=60 * PATIENCE,
        )
    finally:
        os.close(writing)
    assert process.stderr == b""
    assert process.returncode == 141
