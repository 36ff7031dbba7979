"""Compact JSON for values written thousands of times a second: lines of logs, messages, links of
the hash chain. The encoders are created once, whereas ``json.dumps`` and ``JSONEncoder.encode``
create one for each call."""

from __future__ import annotations

import json
import json.encoder
from typing import Any, Callable


def _encoder(sort_keys: bool) -> Callable[[Any], str]:
    plain = json.JSONEncoder(separators=(",", ":"), check_circular=False, sort_keys=sort_keys)
    make = getattr(json.encoder, "c_make_encoder", None)  # other Pythons than CPython have none
    if make is None:
        return plain.encode
    text = json.encoder.encode_basestring_ascii
    chunks = make(None, plain.default, text, None, ":", ",", sort_keys, False, True)

    def encode(value: Any) -> str:
        return "".join(chunks(value, 0))

    return encode


compact = _encoder(sort_keys=False)
"""The JSON text of a value that does not contain itself."""

compact_sorted = _encoder(sort_keys=True)
"""The same, with sorted keys, so that equal values have equal texts."""
