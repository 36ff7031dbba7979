"""Real teams whose processes are killed, cut off while they write, stopped and restarted, and whose
logs are then verified: every robot in turn, or at random for as long as one likes."""
