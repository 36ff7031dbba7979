"""Films: writes a sequence of pictures to a folder of PNG files, or to one film file."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Any, List, Optional

from PIL import Image

from gspn_framework_package.model.errors import ExecutionError, InputError

MOVING_PICTURES = (".gif", ".webp")
"""Extensions of the film formats that Pillow can write."""


def find_ffmpeg() -> Optional[str]:
    """The path of ffmpeg: that of the system, or that of the Python package imageio-ffmpeg; None if
    there is neither."""
    found = shutil.which("ffmpeg")
    if found:
        return found
    try:
        import imageio_ffmpeg

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        return None


class Film:
    """Collects pictures; :meth:`close` finishes the film.

    :param target: a .mp4, .gif or .webp file, or a folder for PNG files.
    :param width: width of the pictures in pixels.
    :param height: height of the pictures in pixels.
    :param rate: pictures per second.
    :raises InputError: another type of file, a file that cannot be written, or .mp4 without ffmpeg.
    """

    def __init__(self, target: Path, width: int, height: int, rate: float) -> None:
        self._target, self._rate = target, rate
        self._frames: List[Image.Image] = []
        self._encoder: Optional[subprocess.Popen[bytes]] = None
        self.count = 0
        kind = target.suffix.lower()
        if kind == ".mp4":
            self._encoder = self._start_encoder(width, height)
        elif kind in MOVING_PICTURES:
            if not target.parent.is_dir():
                raise InputError("the folder does not exist", file=str(target.parent))
        elif kind:
            raise InputError(
                "'%s' is not a film format" % kind,
                file=str(target),
                hint="use .mp4, .gif, .webp, or a folder",
            )
        else:
            try:
                target.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise InputError(
                    "cannot make the folder: %s" % error.strerror, file=str(target)
                ) from None

    def _start_encoder(self, width: int, height: int) -> Any:
        ffmpeg = find_ffmpeg()
        if ffmpeg is None:
            raise InputError(
                ".mp4 needs ffmpeg, which is not installed",
                file=str(self._target),
                hint="install ffmpeg or imageio-ffmpeg, or film into a folder or a .gif",
            )
        words = [ffmpeg, "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]
        words += ["-s", "%dx%d" % (width, height), "-r", "%g" % self._rate, "-i", "-", "-an"]
        words += ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "23", "-preset", "veryfast"]
        words += ["-movflags", "+faststart", str(self._target)]
        return subprocess.Popen(words, stdin=subprocess.PIPE, stderr=subprocess.PIPE)

    def add(self, picture: Image.Image) -> None:
        """Add a picture.

        :raises ExecutionError: the encoder does not accept it.
        """
        self.count += 1
        if self._encoder is not None:
            assert self._encoder.stdin is not None
            try:
                self._encoder.stdin.write(picture.tobytes())
            except BrokenPipeError:
                self.close()
        elif self._target.suffix:
            gif = self._target.suffix.lower() == ".gif"
            self._frames.append(picture.quantize(256) if gif else picture)
        else:
            picture.save(self._target / ("frame_%05d.png" % self.count))

    def close(self) -> None:
        """Finish the film.

        :raises ExecutionError: it could not be written.
        """
        if self._encoder is not None:
            encoder, self._encoder = self._encoder, None
            _, errors = encoder.communicate()
            if encoder.returncode:
                raise ExecutionError(
                    "ffmpeg failed: %s" % errors.decode(errors="replace").strip(),
                    file=str(self._target),
                )
        elif self._frames:
            first, *rest = self._frames
            each = round(1000 / self._rate)  # milliseconds
            first.save(self._target, save_all=True, append_images=rest, duration=each, loop=0)
            self._frames = []
