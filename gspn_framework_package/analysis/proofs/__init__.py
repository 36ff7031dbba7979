"""Proofs about all markings that a net can reach, without visiting them, by the state equation.

Modules: ``dead_markings``, ``program``.
"""
