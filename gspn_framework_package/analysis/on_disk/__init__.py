"""State spaces beyond memory: the reachable markings in sorted files, found layer by layer.

Modules: ``answers``, ``chain``, ``keys``, ``long_run``, ``reach``, ``scratch``, ``search``,
``sorted_keys``, ``steady``.
"""
