"""State spaces beyond memory: the reachable markings in sorted files, found layer by layer."""
