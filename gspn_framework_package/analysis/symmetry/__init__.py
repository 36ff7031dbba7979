"""Exchangeable parts of a net, and its state space with one marking for each orbit of them.

Modules: ``asked``, ``automorphisms``, ``factors``, ``lumped_properties``, ``lumped_space``,
``symmetry``.
"""
