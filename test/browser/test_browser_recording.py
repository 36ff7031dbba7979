"""A long recording in a browser: shown while it is still being read."""

import threading

from page_reading import marking, settle

from benchmarks.page.long_log import write_log
from gspn_framework_package.visualizer import recording


def test_a_log_is_shown_while_it_is_read(serve_folder, open_page, tmp_path, monkeypatch):
    write_log(str(tmp_path / "long.jsonl"), 600)
    half, go_on = threading.Event(), threading.Event()
    keep = recording.Recording._keep

    def held(self, mark):
        keep(self, mark)
        if len(self._marks) == 3:  # 500 lines have been read
            half.set()
            assert go_on.wait(60)

    monkeypatch.setattr(recording.Recording, "_keep", held)
    monkeypatch.setattr("gspn_framework_package.visualizer.replay.TELL", 0)
    site = serve_folder(tmp_path)
    page = open_page(site.address + "#file-long.jsonl")
    assert half.wait(60)
    page.wait_for_selector("#position:has-text('reading the log:')")
    assert (
        page.inner_text("#mode") == "REPLAY"
        and page.evaluate("() => window.gspn.model.head.n") > 100
    )
    page.keyboard.press("ArrowRight")
    page.wait_for_function("() => window.gspn.model.board.n > 0")
    go_on.set()
    page.wait_for_selector("#position:not(:has-text('reading the log:'))")
    page.evaluate("() => window.gspn.model.show(window.gspn.model.head.n)")
    board = site.board("file-long.jsonl")
    settle(page, board.n)
    assert marking(page) == board.marking
