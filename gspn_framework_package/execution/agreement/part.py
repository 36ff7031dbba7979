"""The base of the parts of a replica: each knows the configuration, the state and the parts below.

A part may also know parts that were made before it; :class:`.replica.Replica` makes them in order.
"""

from __future__ import annotations

from dataclasses import dataclass

from gspn_framework_package.execution.agreement.config import Config
from gspn_framework_package.execution.agreement.electorate import Electorate
from gspn_framework_package.execution.agreement.outbox import Outbox
from gspn_framework_package.execution.agreement.proposals import ProposalQueue
from gspn_framework_package.execution.agreement.state import ReplicaState


@dataclass(eq=False)
class ReplicaPart:
    """The data that all parts share."""

    config: Config
    state: ReplicaState
    outbox: Outbox
    electorate: Electorate
    proposals: ProposalQueue
