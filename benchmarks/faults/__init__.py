"""Fault injection on real teams: processes are killed, cut off in mid-write, stopped and restarted,
for every robot in turn or at random for a given time. Their logs are then verified."""
