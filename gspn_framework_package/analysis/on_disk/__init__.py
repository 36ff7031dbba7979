"""State spaces beyond memory: the reachable markings in sorted files, found layer by layer.

Modules: ``answers``, ``chain``, ``keys``, ``reach``, ``scratch``, ``search``,
``sorted_keys``, ``steady``.
"""
