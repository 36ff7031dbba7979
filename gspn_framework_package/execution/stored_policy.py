"""Large policies, stored once beside the logs of a run.

The header of an event log has the plan, so that the log explains itself. With its policy, a plan of
tens of thousands of rows takes megabytes, in the log of every robot. A policy whose JSON is longer
than :data:`INLINE` therefore goes into a file of its own, ``policies/HASH.json`` in the folder of
the log, and the header has its hash: ``"policy": {"hash": HASH}``. All logs in the folder share it.
The file is a policy file like any other.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import os
import re
import tempfile
from typing import Any, Dict, Optional

from gspn_framework_package.formats.plan_json import check_schema, policy_from_json
from gspn_framework_package.model.errors import GspnError, LogError
from gspn_framework_package.model.policy import Policy

FOLDER = "policies"

INLINE = 65_536
"""Most bytes of JSON of a policy that stays in the header: some hundred rows. A log of which the
header can be read at once is better in one file."""


_HASH = re.compile(r"[0-9a-f]{32}\Z")


def stored_separately(plan: Dict[str, Any], log: str, fsync: bool) -> Dict[str, Any]:
    """Return the plan for the header of ``log``; if its policy is large, it is stored first.

    :param plan: the plan as a JSON object, with its policy.
    :param fsync: wait until the policy is on the disk.
    :raises OSError: the policy cannot be written.
    """
    text = json.dumps(plan["policy"], separators=(",", ":"))
    if len(text) <= INLINE:
        return plan
    data = text.encode()
    name = _hash(data)
    path = _file(log, name)
    if _content(path) != data:
        _write(path, data, fsync)
    return {**plan, "policy": {"hash": name}}


def hash_of(plan: Any) -> Optional[str]:
    """The hash of the policy that the plan of a header refers to; None if it has its policy."""
    policy = plan.get("policy") if isinstance(plan, dict) else None
    found = policy.get("hash") if isinstance(policy, dict) else None
    return found if isinstance(found, str) and _HASH.match(found) else None


def read_stored(log: str, name: str) -> Policy:
    """Return the policy with the hash ``name``, to which the header of ``log`` refers.

    :raises LogError: the file is missing, or its content has another hash.
    """
    path = _file(log, name)
    hint = "%s refers to it by its hash %s; copy the folder '%s' together with the logs" % (
        os.path.basename(log),
        name,
        FOLDER,
    )
    data = _content(path)
    if data is None:
        raise LogError("the policy of the log is missing", file=path, hint=hint)
    if _hash(data) != name:
        raise LogError(
            "the policy of the log was altered: its hash is %s" % _hash(data), file=path, hint=hint
        )
    try:
        return _parsed(data)
    except (GspnError, ValueError, RecursionError) as error:
        raise LogError("holds no policy (%s)" % error, file=path, hint=hint) from None


@functools.lru_cache(maxsize=2)
def _parsed(data: bytes) -> Policy:
    """The policy in a file. The logs of a team share one, so it is kept for the next."""
    policy = json.loads(data.decode())
    check_schema(policy, "policy")
    return policy_from_json(policy)


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:32]


def _file(log: str, name: str) -> str:
    return os.path.join(os.path.dirname(os.path.abspath(log)), FOLDER, name + ".json")


def _content(path: str) -> Optional[bytes]:
    try:
        with open(path, "rb") as file:
            return file.read()
    except OSError:
        return None


def _write(path: str, data: bytes, fsync: bool) -> None:
    """Write a file that other processes may write and read at the same time: it is there with all
    of its content, or not at all."""
    folder = os.path.dirname(path)
    os.makedirs(folder, exist_ok=True)
    handle, partial = tempfile.mkstemp(prefix=".", suffix=".part", dir=folder)
    try:
        with open(handle, "wb") as file:
            file.write(data)
            if fsync:
                file.flush()
                os.fsync(file.fileno())
        os.chmod(partial, 0o644)
        os.replace(partial, path)
    except OSError:
        with contextlib.suppress(OSError):
            os.unlink(partial)
        raise
    if fsync:
        for place in (folder, os.path.dirname(folder)):
            _sync(place)


def _sync(folder: str) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
