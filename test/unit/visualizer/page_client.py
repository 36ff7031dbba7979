"""A client of the page's application, as a browser on the right page is: what the tests vary
from."""

import json

from gspn_framework_package.model.builder import NetBuilder
from gspn_framework_package.visualizer.app import create_app
from gspn_framework_package.visualizer.documents import Document, Folder
from gspn_framework_package.visualizer.guard import HEADER, Guard
from gspn_framework_package.visualizer.project import Project
from gspn_framework_package.visualizer.session import Session

HOST = "127.0.0.1:8090"


def small_net():
    return (
        NetBuilder("small")
        .place("a", 1)
        .place("b")
        .exponential("t", 1.0, inputs="a", outputs="b")
        .immediate("u", inputs="b", outputs="a")
        .build()
    )


class PageClient:
    """Requests as the page sends them; ``headers`` replace or (None) take away."""

    def __init__(self, project=None, guard=None, start_execution=None):
        self.project = project or Project()
        if project is None:
            document = Document("small", small_net())
            self.project.show(Session("small", document, start_execution=start_execution))
        self.app = create_app(self.project, guard or Guard("127.0.0.1", 8090))
        self.client = self.app.test_client(use_cookies=True)

    def get(self, path, **headers):
        return self.client.get(path, headers=_merged({"Host": HOST}, headers))

    def post(self, path, body=None, data=None, **headers):
        usual = {
            "Host": HOST,
            "Origin": "http://" + HOST,
            "Sec-Fetch-Site": "same-origin",
            HEADER: "1",
            "Content-Type": "application/json",
        }
        text = json.dumps({} if body is None else body) if data is None else data
        return self.client.post(path, data=text, headers=_merged(usual, headers))

    def do(self, command, session="small", **fields):
        return self.post("/api/do?id=" + session, {"command": command, **fields})

    def board(self, session="small"):
        return self.get("/api/poll?id=" + session).get_json()["snapshot"]["board"]


def _merged(usual, changes):
    changes = {name.replace("_", "-"): value for name, value in changes.items()}
    return {k: v for k, v in {**usual, **changes}.items() if v is not None}


def folder_project(path):
    return Project(Folder(str(path)))
