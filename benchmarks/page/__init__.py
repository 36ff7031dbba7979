"""The page under load: its drawing speed, the number of viewers it serves, its cost to a team."""
