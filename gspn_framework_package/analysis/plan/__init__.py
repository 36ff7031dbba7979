"""What a plan adds to its net: the policy, the robots' own behaviour, places that only count."""
