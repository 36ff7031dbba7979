"""The analysis of a net whose states are distributed over the processes of MPI, called ranks.

Each state belongs to the rank that its hash names. In rounds, every rank expands some of its states
and sends each successor to the rank that it belongs to (G. Ciardo, J. Gluckman and D. Nicol 1998;
S. Caselli, G. Conte and P. Marenzoni 2001). No rank ever holds all states.
"""

from gspn_framework_package.analysis.distributed.analysis import DistributedAnalysis
from gspn_framework_package.analysis.distributed.ranks import Ranks

__all__ = ["DistributedAnalysis", "Ranks"]
