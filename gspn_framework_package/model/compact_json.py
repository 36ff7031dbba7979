"""Compact JSON for values written thousands of times a second: lines of logs, messages, links of
the hash chain. The encoders are created once, whereas ``json.dumps`` creates one for each call."""

from __future__ import annotations

import json

compact = json.JSONEncoder(separators=(",", ":"), check_circular=False).encode
"""The JSON text of a value that does not contain itself."""

compact_sorted = json.JSONEncoder(
    separators=(",", ":"), check_circular=False, sort_keys=True
).encode
"""The same, with sorted keys, so that equal values have equal texts."""
