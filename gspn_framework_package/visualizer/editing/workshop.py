"""What the editor does with the files of the served folder."""

from __future__ import annotations

import os

from gspn_framework_package.visualizer.documents import Folder
from gspn_framework_package.visualizer.editing.open_document import Opened, open_document


class Workshop:
    """The editor's hands on the served folder."""

    def __init__(self, folder: Folder) -> None:
        self.folder = folder

    def open(self, path: str) -> Opened:
        """Open a plan or net for editing. :raises GspnError: it cannot be opened."""
        return open_document(self.folder, path)

    def read_only(self, opened: Opened) -> str:
        """Why the document cannot be saved where it is; "" if it can."""
        parts = opened.parts
        if not parts.plan_file:
            return "a net alone: save it as a plan, in a folder of its own"
        if parts.thesis:
            return "an input file of the thesis: save it as a plan, in a folder of its own"
        for file in parts.files:
            if not os.access(os.path.dirname(file), os.W_OK | os.X_OK):
                return "nothing can be written in the folder of %s" % os.path.basename(file)
        return ""
