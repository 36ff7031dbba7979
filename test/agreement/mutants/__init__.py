"""Deliberate faults in the protocol, the token game, the ledger, the host, the verifier, what messages
pass and what watchers read, to confirm that they are caught.

A simulation and a checker that find no fault prove nothing unless they find planted ones. Each
mutant breaks one rule on purpose; :func:`hunt` runs schedules until one fails.
"""

from __future__ import annotations

from typing import List

from agreement.mutants import (
    checks,
    deployment,
    host,
    memory,
    mended,
    outage,
    protocol,
    reactions,
    records,
    survivors,
    token_game,
)
from agreement.mutants.mutant import (
    Caught,
    Mutant,
    hunt,
)

__all__ = ["MUTANTS", "Caught", "Mutant", "hunt"]

MUTANTS: List[Mutant] = [
    *protocol.MUTANTS,
    *token_game.MUTANTS,
    *host.MUTANTS,
    *memory.MUTANTS,
    *outage.MUTANTS,
    *reactions.MUTANTS,
    *deployment.MUTANTS,
    *survivors.MUTANTS,
    *mended.MUTANTS,
    *checks.MUTANTS,
    *records.MUTANTS,
]
"""All of them, by the part of the program that they are in."""
