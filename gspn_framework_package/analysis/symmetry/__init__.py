"""Exchangeable parts of a net, and its state space with one marking per orbit.

Modules: ``asked``, ``automorphisms``, ``factors``, ``lumped_properties``, ``lumped_space``,
``symmetry``.
"""
