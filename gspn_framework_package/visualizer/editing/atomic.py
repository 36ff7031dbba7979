"""Writing the files of a plan: all of them or none.

New contents are first written next to the old files and flushed to the disk, then renamed. If there
are several, a journal lists them meanwhile: if the server dies between two renames, :func:`recover`
completes the rest when the plan is next opened.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import secrets
import stat
from typing import Any, Dict, List, Mapping, NamedTuple, Optional

from gspn_framework_package.execution.stored_policy import sync_folder
from gspn_framework_package.formats.source import read_bytes
from gspn_framework_package.model.errors import InputError
from gspn_framework_package.visualizer.documents import Folder

JOURNAL = ".gspn_saving.json"
"""The journal, in the folder of the plan."""

_JOURNAL_BYTES = 100_000
_PART = ".gspn-part"


class _File(NamedTuple):
    """A file being replaced: its path, the path of its new content, and hashes."""

    path: str
    temporary: str
    before: str
    after: str


def write_all(folder: Folder, place: str, contents: Mapping[str, bytes]) -> None:
    """Replace files by new contents, all or none.

    :param place: the folder of the plan.
    :param contents: absolute path -> content; each file or its folder must exist.
    :raises InputError: they cannot be written; in this case, none has changed.
    """
    files: List[_File] = []
    old: Dict[str, Optional[bytes]] = {}
    path = place
    try:
        for path, data in contents.items():
            old[path] = read_bytes(path) if os.path.lexists(path) else None
            temporary = _write_beside(path, data)
            files.append(_File(path, temporary, _hash(old[path]), _hash(data)))
        if len(files) > 1:
            _write_journal(place, files)
    except OSError as error:
        _forget(place, files)
        raise _cannot(folder, path, error) from None
    except BaseException:
        _forget(place, files)
        raise
    for number, file in enumerate(files):
        try:
            os.replace(file.temporary, file.path)
        except OSError as error:
            _put_back(files[:number], old)
            _forget(place, files)
            raise _cannot(folder, file.path, error) from None
    for directory in {os.path.dirname(file.path) for file in files}:
        _flush_folder(directory)
    with contextlib.suppress(OSError):
        os.unlink(os.path.join(place, JOURNAL))


def recover(folder: Folder, place: str) -> None:
    """Finish the saving in a folder that a server began before it died."""
    journal = os.path.join(place, JOURNAL)
    if not os.path.lexists(journal):
        return
    files = _read_journal(folder, place, journal)
    # files changed by somebody since then are kept
    if all(_hash_of(file.path) in (file.before, file.after) for file in files):
        for file in files:
            if _hash_of(file.temporary) == file.after:
                with contextlib.suppress(OSError):
                    os.replace(file.temporary, file.path)
    _forget(place, files)


def _write_beside(path: str, data: bytes) -> str:
    """Write a file in the folder of another, with its permissions, and flush it to the disk."""
    directory, name = os.path.split(path)
    temporary = os.path.join(directory, ".%s.%s%s" % (name[:100], secrets.token_hex(6), _PART))
    mode = 0o666
    with contextlib.suppress(OSError):
        mode = stat.S_IMODE(os.stat(path).st_mode)
    with open(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
        try:
            file.write(data)
            file.flush()
            if os.path.exists(path):
                os.fchmod(file.fileno(), mode)
            os.fsync(file.fileno())
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
            raise
    return temporary


def _write_journal(place: str, files: List[_File]) -> None:
    entries = [
        {
            **f._asdict(),
            "path": _relative(f.path, place),
            "temporary": _relative(f.temporary, place),
        }
        for f in files
    ]
    made = _write_beside(os.path.join(place, JOURNAL), json.dumps({"files": entries}).encode())
    try:
        os.replace(made, os.path.join(place, JOURNAL))
    except OSError:
        with contextlib.suppress(OSError):
            os.unlink(made)
        raise
    for directory in {place, *(os.path.dirname(file.path) for file in files)}:
        _flush_folder(directory)


def _read_journal(folder: Folder, place: str, journal: str) -> List[_File]:
    """The files of a journal that are in the served folder; none if it is not a valid journal."""
    found: List[_File] = []
    try:
        if os.path.islink(journal):
            return []
        data: Any = json.loads(read_bytes(journal, _JOURNAL_BYTES))
        for entry in data["files"]:
            path, temporary = (
                os.path.join(os.path.realpath(os.path.join(place, os.path.dirname(entry[key]))),
                             os.path.basename(entry[key]))
                for key in ("path", "temporary")
            )  # fmt: skip
            is_ours = temporary.endswith(_PART) and not os.path.islink(temporary)
            if not is_ours or not folder.inside(path) or not folder.inside(temporary):
                return []
            found.append(_File(path, temporary, str(entry["before"]), str(entry["after"])))
    except (InputError, OSError, ValueError, KeyError, TypeError, AttributeError):
        return []
    return found


def _relative(path: str, place: str) -> str:
    return os.path.relpath(path, place)


def _put_back(files: List[_File], old: Mapping[str, Optional[bytes]]) -> None:
    for file in files:
        before = old[file.path]
        with contextlib.suppress(OSError):
            if before is None:
                os.unlink(file.path)
            else:
                os.replace(_write_beside(file.path, before), file.path)


def _forget(place: str, files: List[_File]) -> None:
    with contextlib.suppress(OSError):
        os.unlink(os.path.join(place, JOURNAL))
    for file in files:
        with contextlib.suppress(OSError):
            os.unlink(file.temporary)


def _flush_folder(path: str) -> None:
    with contextlib.suppress(OSError):
        sync_folder(path)


def _hash(data: Optional[bytes]) -> str:
    return "" if data is None else hashlib.sha256(data).hexdigest()


def _hash_of(path: str) -> str:
    try:
        return _hash(read_bytes(path))
    except InputError:
        return ""


def _cannot(folder: Folder, path: str, error: OSError) -> InputError:
    return InputError(
        "cannot write it: %s; nothing was changed" % (error.strerror or error),
        file=folder.inside(path) or os.path.basename(path),
        hint="the page keeps your changes: free some space or save it as another plan",
    )
