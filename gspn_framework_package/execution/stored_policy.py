"""Stores large policies once, next to the logs of a run.

The header of an event log contains the plan, so that the log is self-contained. A policy of tens of
thousands of rows would take megabytes in the log of every robot. A policy whose JSON is longer than
:data:`INLINE` is therefore stored in a separate file, ``policies/HASH.json`` in the folder of the
log, and the header contains its hash: ``"policy": {"hash": HASH}``. All logs in the folder share
it. The file is a policy file like any other. The policies of plans that a team stages and adopts
are stored in the same way.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import os
import re
import tempfile
from typing import Any, Callable, Dict, Mapping, Optional, TypeVar

from gspn_framework_package.formats.plan_json import check_schema, policy_from_json
from gspn_framework_package.formats.source import read_bytes
from gspn_framework_package.model.compact_json import compact
from gspn_framework_package.model.errors import GspnError, InputError, LogError
from gspn_framework_package.model.policy import Policy

FOLDER = "policies"

INLINE = 65_536
"""Maximum size in bytes of a policy's JSON in the header: some hundred rows. As long as the header
is quick to read, a single file is better."""


_Value = TypeVar("_Value")

_HASH = re.compile(r"[0-9a-f]{32}\Z")


def stored_separately(plan: Dict[str, Any], log: str, fsync: bool) -> Dict[str, Any]:
    """Return the plan for a line of ``log``, after storing its policy separately if it is large.

    :param plan: the plan as a JSON object, with its policy.
    :param fsync: wait until the policy is on the disk.
    :raises OSError: the policy cannot be written.
    """
    policy = plan.get("policy")
    if not policy or hash_of(plan) is not None:
        return plan
    text = compact(policy)
    if len(text) <= INLINE:
        return plan
    data = text.encode()
    name = _hash(data)
    path = _file(log, name)
    if _content(path) != data:
        _write(path, data, fsync)
    return {**plan, "policy": {"hash": name}}


def without_large_policies(record: Mapping[str, Any], log: str, fsync: bool) -> Dict[str, Any]:
    """Return a record for ``log`` in which large policies of staged and adopted plans are replaced
    by hashes, after storing them.

    :param fsync: as for :func:`stored_separately`.
    :raises OSError: a policy cannot be written.
    """
    return _with_plans(record, lambda plan: stored_separately(plan, log, fsync))


def with_policies(record: Mapping[str, Any], log: str) -> Dict[str, Any]:
    """Return a record of ``log`` with the policies to which it refers by their hashes.

    :raises LogError: one is missing, or has another hash.
    """

    def whole(plan: Dict[str, Any]) -> Dict[str, Any]:
        name = hash_of(plan)
        return plan if name is None else {**plan, "policy": _read(log, name, _object)}

    return _with_plans(record, whole)


def _with_plans(
    record: Mapping[str, Any], change: Callable[[Dict[str, Any]], Dict[str, Any]]
) -> Dict[str, Any]:
    """The record, with ``change`` applied to each staged or adopted plan in it. Values that are not
    plans, as in an altered log, are left unchanged."""

    def holder(value: Any) -> Any:
        if isinstance(value, dict) and isinstance(value.get("plan"), dict):
            return {**value, "plan": change(value["plan"])}
        return value

    def entry(value: Any) -> Any:
        is_stage = isinstance(value, dict) and value.get("entry") == "stage"
        return holder(value) if is_stage else value

    changed = dict(record)
    if "entry" in record:
        changed["entry"] = entry(record["entry"])
    if isinstance(record.get("entries"), list):
        changed["entries"] = [entry(value) for value in record["entries"]]
    if isinstance(record.get("batch"), list):
        changed["batch"] = [
            [entry(item[0]), *item[1:]] if isinstance(item, (list, tuple)) and item else item
            for item in record["batch"]
        ]
    if isinstance(record.get("state"), dict):
        state = changed["state"] = dict(record["state"])
        for key in ("staged", "adopted"):
            if key in state:
                state[key] = holder(state[key])
    return changed


def hash_of(plan: Any) -> Optional[str]:
    """The hash of the policy that the plan of a header refers to; None if the header contains the
    policy."""
    policy = plan.get("policy") if isinstance(plan, dict) else None
    found = policy.get("hash") if isinstance(policy, dict) else None
    return found if isinstance(found, str) and _HASH.match(found) else None


def read_stored(log: str, name: str) -> Policy:
    """Read the policy with the hash ``name``, to which the header of ``log`` refers.

    :raises LogError: the file is missing, or its content has another hash.
    """
    return _read(log, name, _parsed)


def _read(log: str, name: str, parse: Callable[[bytes], _Value]) -> _Value:
    """Read and parse the file of a policy. :raises LogError: see :func:`read_stored`."""
    path = _file(log, name)
    hint = "%s refers to it by the hash %s; copy the folder '%s' together with the logs" % (
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
        return parse(data)
    except (GspnError, ValueError, RecursionError) as error:
        raise LogError("holds no policy (%s)" % error, file=path, hint=hint) from None


@functools.lru_cache(maxsize=2)
def _object(data: bytes) -> Dict[str, Any]:
    """The JSON object in a file. It is shared by all records that refer to it, so do not change
    it."""
    found = json.loads(data.decode())
    if not isinstance(found, dict):
        raise ValueError("no JSON object")
    return found


@functools.lru_cache(maxsize=2)
def _parsed(data: bytes) -> Policy:
    """The policy in a file, cached because the logs of a team share it."""
    policy = json.loads(data.decode())
    check_schema(policy, "policy")
    return policy_from_json(policy)


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:32]


def _file(log: str, name: str) -> str:
    return os.path.join(os.path.dirname(os.path.abspath(log)), FOLDER, name + ".json")


def _content(path: str) -> Optional[bytes]:
    try:
        return read_bytes(path)
    except InputError:
        return None


def _write(path: str, data: bytes, fsync: bool) -> None:
    """Write a file atomically, because other processes may write and read it at the same time."""
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
            sync_folder(place)


def sync_folder(path: str) -> None:
    """Sync a folder, so that the name of a new file in it survives a power failure."""
    folder = os.open(path, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
