"""Reads the topics and services of a ROS master with their types."""

from __future__ import annotations

import time
from typing import Dict, Tuple

from gspn_framework_package.ros.transport.registration import (
    MASTER_ERRORS,
    service_names,
    topic_types,
)
from gspn_framework_package.ros.transport.service_call import service_type

__all__ = ["MASTER_ERRORS", "live_graph"]

HIDDEN = ("/get_loggers", "/set_logger_level", "/set_parameters")
"""Suffixes of the names of services that every node has."""


def live_graph(timeout: float = 2.0) -> Tuple[Dict[str, str], Dict[str, str]]:
    """Return topic -> type and service -> type. The type of a service is queried from its node; it
    is "" if there was not enough time to ask all nodes.

    :param timeout: seconds for each of the two.
    :raises OSError: or another of :data:`MASTER_ERRORS`, the master does not answer.
    """
    topics = topic_types(timeout)
    services = {}
    end = time.monotonic() + timeout
    for name in service_names(timeout):
        if name.endswith(HIDDEN):
            continue
        found = service_type(name, timeout / 4) if time.monotonic() < end else None
        services[name] = found.type if found is not None else ""
    return topics, services
