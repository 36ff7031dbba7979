"""Functions that are written in the page: what is wrong with one, where it is written, and that
nothing else is written, overwritten, read by others, or run."""

import itertools
import os
import shutil
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from page_client import PageClient

from gspn_framework_package.execution.plan_modules import allow_modules
from gspn_framework_package.model.errors import GspnError
from gspn_framework_package.visualizer.documents import Folder
from gspn_framework_package.visualizer.editing.functions import (
    LONGEST_FUNCTION,
    problem_of_function,
    read_function,
    write_function,
)
from gspn_framework_package.visualizer.guard import TOKEN_HEADER, Guard
from gspn_framework_package.visualizer.project import Project

KEY = "?id=file-patrol/plan.json"
TEXT = "def sweep(robot, speed: float = 0.5):\n    return None\n"


class Editor(PageClient):
    def __init__(self, folder, guard=None):
        super().__init__(Project(Folder(str(folder)), edits=True), guard)

    def ask(self, name, status=200, **fields):
        answer = self.post("/api/edit/function" + KEY, {"function": name, **fields})
        assert answer.status_code == status, answer.get_json()
        return answer.get_json()


@pytest.fixture(name="folder")
def _folder(tmp_path):
    shutil.copytree("plans/patrol", str(tmp_path / "served" / "patrol"))
    return tmp_path / "served"


@pytest.fixture(name="editor")
def _editor(folder):
    return Editor(folder)


def contents(folder):
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_a_function_is_written_and_opened_and_changed(folder, editor):
    before = contents(folder)
    assert editor.ask("tasks.sweep") == {"file": "tasks.py", "text": "", "version": ""}
    found = editor.ask("tasks.sweep", text=TEXT)
    (speed,) = found.pop("parameters")
    assert speed == {"name": "speed", "required": False, "default": 0.5, "type": "float"}
    assert found == {"problem": "", "line": None} and contents(folder) == before
    written = editor.ask("tasks.sweep", text=TEXT, version="", save=True)
    assert written["text"] == TEXT and editor.ask("tasks.sweep") == written
    assert contents(folder) == {**before, folder / "patrol" / "tasks.py": TEXT.encode()}
    functions = editor.get("/api/edit/palette" + KEY).get_json()["functions"]
    assert {"name": "tasks.sweep", "parameters": [speed]}.items() <= {
        key: value
        for each in functions
        if each["name"] == "tasks.sweep"
        for key, value in each.items()
    }.items()
    # the version is that of the function: the rest of the file may change meanwhile
    file = folder / "patrol" / "tasks.py"
    file.write_text("import time  # new\n\n\n" + TEXT)
    longer = TEXT.replace("None", "'T'")
    again = editor.ask("tasks.sweep", text=longer, version=written["version"], save=True)
    assert file.read_text() == "import time  # new\n\n\n" + longer
    # somebody else has changed it, or has written one of this name
    for version in (written["version"], "", None, 3):
        answer = editor.ask("tasks.sweep", 409, text=TEXT, version=version, save=True)
        assert "has changed since you opened it" in answer["error"]
    assert file.read_text() == "import time  # new\n\n\n" + longer
    assert editor.ask("tasks.sweep") == again
    file.write_text("")
    editor.ask("tasks.sweep", 409, text=TEXT, version=again["version"], save=True)


WRONG = [
    ("def sweep(:\n    pass", 1, ""),
    ("def sweep():\n    x = 1\n   y = 2", 3, "indent"),
    ("def sweep():\n    return 'a", 2, ""),
    ("import os\ndef sweep(): pass", 1, "imports go inside"),
    ("def sweep(): pass\ndef sweep(): pass", 2, "only"),
    ("def sweep(): pass\nprint()", 2, "only"),
    ("return 1", 1, "outside"),
    ("async def sweep(): pass", 1, "only"),
    ("class sweep: pass", 1, "only"),
    ("x = 1", 1, "only"),
    ("", None, "missing"),
    ("def sweep():\n    '\0'", None, ""),
    ("def sweep():\n    '\ud800'", None, "character"),
    ("def sweep():\n    return %s1" % ("-" * 15_000), None, "deep"),
    ("def sweep():\n    return a%s" % (".b" * 9_000), None, "deep"),
    ("def sweep(): pass" + " " * LONGEST_FUNCTION, None, "longer than 20000"),
]
"""Source, the line with the fault, part of what is said about it."""


def test_what_is_wrong_with_a_function_is_said_with_its_line_and_is_not_written(folder, editor):
    before = contents(folder)
    for text, line, part in WRONG:
        found = problem_of_function("tasks.sweep", text)
        assert found["problem"] and "\n" not in found["problem"] and part in found["problem"], text
        assert found["line"] in ({line} if line else {None, 2}) and found["parameters"] == []
        answer = editor.ask("tasks.sweep", 400, text=text, version="", save=True)
        assert found["problem"] in answer["error"]
        assert contents(folder) == before


NAMES = [
    *(None, 3, "", "sweep", "tasks.", ".sweep", "tasks..sweep", "tasks.1x", "tasks.a b"),
    *("../tasks.sweep", "a/../../tasks.sweep", "/tmp/tasks.sweep", "./tasks.sweep"),
    *("..tasks.sweep", "tasks/../x.sweep", ".hidden/tasks.sweep", "tasks\\x.sweep"),
    *("tasks.sweep\n", "tasks.sw\0eep", "tasks.\ud800", "tasks.aﬁ", "tasks.def", "class.sweep"),
    *("json.sweep", "gspn_framework_package.sweep", "conftest.sweep", "sitecustomize.sweep"),
    *("parts.sweep", "nowhere/tasks.sweep", "linked.sweep", "dangling.sweep", "away/tasks.x"),
    *("here.sweep", "a." * 200 + "sweep", "pipe.sweep"),
]


def test_nothing_is_written_or_read_outside_of_the_plans_folder(folder, editor):
    patrol, outside = folder / "patrol", folder.parent / "outside"
    outside.mkdir()
    (outside / "secret.py").write_text("def sweep(): 'secret'\n")
    (patrol / "parts").mkdir()
    (patrol / "real.py").write_text("def sweep(): 'real'\n")
    os.mkfifo(str(patrol / "pipe.py"))
    for link, target in (
        ("linked.py", outside / "secret.py"),
        ("dangling.py", outside / "new.py"),
        ("away", outside),
        ("here.py", patrol / "real.py"),
    ):
        os.symlink(str(target), str(patrol / link))
    before = contents(folder.parent)
    save = {"text": TEXT, "version": "", "save": True}
    for name, fields in itertools.product(NAMES, ({}, save)):
        answer = editor.post("/api/edit/function" + KEY, {"function": name, **fields})
        assert answer.status_code in (400, 409), name
        error = answer.get_json()["error"]
        assert "\n" not in error and "secret" not in error and str(folder.parent) not in error
    assert contents(folder.parent) == before


def test_who_looks_hears_what_cannot_be_written(folder, editor):
    (folder / "patrol" / "tasks.py").write_text("class sweep:\n    pass\n")
    for name in ("json.dumps", "away.tasks.sweep", "tasks.sweep", "no name"):
        assert editor.ask(name, look=True).keys() == {"problem"}
    found = editor.ask("tasks.other", look=True)
    assert found == {"file": "tasks.py", "text": "", "version": ""}


def test_a_draft_keeps_what_is_typed(editor):
    opened = editor.get("/api/edit" + KEY).get_json()
    source = {"file": "tasks.py", "text": "def sw", "version": ""}
    sent = {"etag": opened["etag"], "document": opened["document"]}
    for sources, status in (
        ({"tasks.sweep": source}, 200),
        ({"tasks.sweep": {**source, "text": "x" * (LONGEST_FUNCTION + 1)}}, 400),
        ({"tasks.sweep": "def sw"}, 400),
        ([source], 400),
    ):
        history = {"done": [], "undone": [], "sources": sources}
        answer = editor.post("/api/edit/draft" + KEY, {**sent, "history": history})
        assert answer.status_code == status, answer.get_json()
    draft = editor.get("/api/edit" + KEY).get_json()["draft"]
    assert draft["history"]["sources"] == {"tasks.sweep": source}


def test_only_who_may_edit_reads_writes_and_checks_functions(folder):
    tokens = {"token": "o" * 20, "viewer_token": "v" * 20}
    client = Editor(folder, Guard("0.0.0.0", 8090, **tokens))
    before = contents(folder)
    save = {"function": "tasks.sweep", "text": TEXT, "version": "", "save": True}
    path = "/api/edit/function" + KEY
    for body in (save, {"function": "tasks.sweep"}, {"function": "tasks.sweep", "text": "("}):
        assert client.post(path, body, **{TOKEN_HEADER: tokens["viewer_token"]}).status_code == 403
        assert client.post(path, body).status_code == 401
        for foreign in ({"Origin": "http://evil.example"}, {"Sec-Fetch-Site": "cross-site"}):
            own = {TOKEN_HEADER: tokens["token"]}
            assert client.post(path, body, **own, **foreign).status_code == 403
        shut = PageClient(Project(Folder(str(folder))))
        assert "--edit" in shut.post(path, body).get_json()["error"]
    assert client.get(path, **{TOKEN_HEADER: tokens["token"]}).status_code == 405
    assert contents(folder) == before
    assert client.post(path, save, **{TOKEN_HEADER: tokens["token"]}).status_code == 200


def test_nothing_that_is_written_runs(folder, editor, tmp_path):
    evil = "def sweep(x=open(%r, 'w')):\n    pass\n" % str(tmp_path / "ran")
    for fields in ({"text": evil}, {"text": evil, "version": "", "save": True}, {}):
        editor.ask("tasks.sweep", **fields)
    editor.get("/api/edit/palette" + KEY)
    assert not (tmp_path / "ran").exists() and "tasks" not in sys.modules


TAKEN = [
    "from json import dumps as sweep\n",
    "from os.path import *\n",
    "sweep = print\n",
    "if True:\n    def sweep(): pass\n",
    "class sweep:\n    pass\n",
    "def sweep(): pass\ndef sweep(): pass\n",
    "async def sweep(): pass\n",
    "def broken(:\n",
    "# -*- coding: nonsense -*-\n",
    "x = 1 \\\n",
]


def test_what_has_the_name_already_is_not_overwritten(folder, editor):
    for content, version in itertools.product(TAKEN, ("", "x")):
        (folder / "patrol" / "tasks.py").write_text(content)
        before = contents(folder)
        fields = {"text": TEXT, "version": version, "save": True}
        answer = editor.post("/api/edit/function" + KEY, {"function": "tasks.sweep", **fields})
        assert answer.status_code in (400, 409) and "\n" not in answer.get_json()["error"]
        answer = editor.post("/api/edit/function" + KEY, {"function": "tasks.sweep"})
        assert answer.status_code in (400, 409), content
        assert contents(folder) == before, content


def test_what_the_file_would_make_something_else_of_is_not_written(folder, editor):
    file = folder / "patrol" / "tasks.py"
    file.write_text("# -*- coding: latin-1 -*-\n")
    text = "def sweep():\n    return 'é'\n"
    answer = editor.ask("tasks.sweep", 409, text=text, version="", save=True)
    assert "without changing" in answer["error"]
    assert file.read_text() == "# -*- coding: latin-1 -*-\n"
    text = "# -*- coding: latin-1 -*-\n" + text
    assert "without" in editor.ask("new.sweep", 409, text=text, version="", save=True)["error"]
    assert not (folder / "patrol" / "new.py").exists()


PARTS = [
    "import os",
    "# a comment, é",
    "X = '''a\n\n\u2028b'''",
    "@staticmethod\ndef other(a,\n          b=1):  # what\n    '''Other.'''\n    return a",
    "\f",
    "",
    "    ",
    "if os:\n    pass",
]


@pytest.mark.long
@given(
    st.lists(st.sampled_from(PARTS), max_size=5),
    st.lists(st.sampled_from(PARTS), max_size=5),
    st.sampled_from(["\n", "\r\n"]),
    st.booleans(),
    st.sampled_from([TEXT, "# why\n@other\n" + TEXT.rstrip(), "\n\ndef sweep(): pass  # é\n\n"]),
)
@settings(max_examples=60, deadline=None)
def test_the_rest_of_the_file_keeps_its_bytes(tmp_path_factory, before, after, end, last, text):
    place = tmp_path_factory.mktemp("plan")
    head = "".join(part + "\n" for part in before).replace("\n", end).encode()
    tail = "".join(part + "\n" for part in after).replace("\n", end).encode()
    if not last:
        tail = tail.rstrip(b"\r\n")
    file = place / "tasks.py"
    folder = Folder(str(place))
    # a new one goes to the end
    file.write_bytes(head + tail)
    written = write_function(folder, str(place), "tasks.sweep", text, "")
    assert file.read_bytes().startswith(head + tail)
    # an old one is replaced in its place
    own = ("@property\ndef sweep():\n    pass\n").replace("\n", end).encode()
    file.write_bytes(head + own + tail)
    version = read_function(str(place), "tasks.sweep").version
    again = write_function(folder, str(place), "tasks.sweep", text, version)
    found = file.read_bytes()
    assert found.startswith(head) and found.endswith(tail) and b"property" not in found
    assert end == "\n" or b"\n" not in found.replace(b"\r\n", b"")
    assert again.version == written.version or "\r" in end or "# why" in text
    assert sorted(path.name for path in place.iterdir()) == ["tasks.py"]


def test_a_plan_that_is_not_saved_in_place_gets_no_functions(folder):
    page = Editor(folder)
    body = {"function": "tasks.sweep", "text": TEXT, "version": "", "save": True}
    answer = page.post("/api/edit/function?id=file-patrol/net.xml", body)
    assert answer.status_code == 409 and "only a net" in answer.get_json()["error"]
    assert not (folder / "patrol" / "tasks.py").exists()


def test_allowed_modules_are_no_reason_to_write_elsewhere(tmp_path):
    plan, parts = tmp_path / "plan", tmp_path / "parts"
    plan.mkdir()
    parts.mkdir()
    os.symlink(str(parts), str(plan / "parts"))
    allow_modules([str(parts) + os.sep])
    try:
        with pytest.raises(GspnError, match="link"):
            write_function(Folder(str(plan)), str(plan), "parts/tasks.sweep", TEXT, "")
    finally:
        allow_modules([])
    assert not list(parts.iterdir())
