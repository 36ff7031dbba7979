"""The Markov chain of a state space: tangible markings only, vanishing ones eliminated.

Modules: ``markov_chain``, ``vanishing``.
"""

from gspn_framework_package.analysis.chain.markov_chain import Chain, Component

__all__ = ["Chain", "Component"]
