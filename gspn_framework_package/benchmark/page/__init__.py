"""The page under load: how fast it draws, how many can watch, what it costs a team of robots."""
