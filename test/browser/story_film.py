"""A film of a page: pictures that a test takes at its steps, each with a line that says what happens.
``pytest test/browser/test_browser_edit_story.py --film docs/images/editor.webp`` makes that of the
editor."""

import io

from PIL import Image

WIDTH, HEIGHT = 1120, 700

SCENE = """() => {
  const line = document.createElement("div");
  line.id = "film-line";
  line.style.cssText = `position:fixed; left:50%; bottom:46px; transform:translateX(-50%); z-index:9999;
    pointer-events:none; padding:9px 18px; border-radius:999px; background:#1b2430ee; color:#fff;
    font:600 16px system-ui, "DejaVu Sans", sans-serif; white-space:nowrap; box-shadow:0 3px 14px #0005`;
  line.hidden = true;
  const hand = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  hand.id = "film-hand";
  hand.setAttribute("viewBox", "0 0 16 22");
  hand.style.cssText = "position:fixed; left:-40px; top:0; width:18px; z-index:9999; pointer-events:none";
  hand.innerHTML = `<path d="M1 1v16l4-4 3 7 3-1-3-7h6z" fill="#1b2430" stroke="#fff" stroke-width="1.3"/>`;
  document.addEventListener("mousemove", ({ clientX, clientY }) => {
    hand.style.left = `${clientX}px`;
    hand.style.top = `${clientY}px`;
  }, true);
  document.documentElement.append(line, hand);
}"""
SAY = """(text) => {
  const line = document.getElementById("film-line");
  line.textContent = text;
  line.style.bottom = ["LIVE", "SIMULATE"].includes(document.body.dataset.mode) ? "175px" : "46px";
  line.hidden = !text;
}"""


class NoFilm:
    """Takes no pictures: the test runs for itself."""

    taking = False

    def begin(self, page):
        pass

    def say(self, text, seconds=1.0):
        pass

    def look(self, seconds=0.4):
        pass

    def watch(self, seconds=1.5):
        pass

    def close(self):
        pass


class StoryFilm(NoFilm):
    """Takes the pictures of a film.

    :param path: the .webp file that is written at the end.
    """

    taking = True

    def __init__(self, path):
        self.path = path
        self.page = None
        self.pictures, self.seconds = [], []

    def begin(self, page):
        """Film this page from now on."""
        self.page = page
        page.evaluate(SCENE)

    def say(self, text, seconds=1.0):
        """Show a line under the page, and take a picture that stays for so long."""
        self.page.evaluate(SAY, text)
        self.look(seconds)

    def look(self, seconds=0.4):
        """Take a picture; it stays in the film for so long."""
        picture = Image.open(io.BytesIO(self.page.screenshot())).convert("RGB")
        if self.pictures and picture.tobytes() == self.pictures[-1].tobytes():
            self.seconds[-1] += seconds
            return
        self.pictures.append(picture)
        self.seconds.append(seconds)

    def watch(self, seconds=1.5):
        """Film what moves by itself for so long."""
        for _ in range(round(seconds / 0.25)):
            self.look(0.25)
            self.page.wait_for_timeout(100)

    def close(self):
        """Write the film."""
        first, *rest = self.pictures
        first.save(
            self.path,
            save_all=True,
            append_images=rest,
            duration=[round(1000 * seconds) for seconds in self.seconds],
            loop=0,
            quality=72,
            method=4,
            minimize_size=True,
        )
