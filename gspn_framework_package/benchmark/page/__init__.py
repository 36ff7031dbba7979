"""The page under load: how fast it draws, how many viewers it serves, what it costs a team."""
