"""What a plan adds to its net: the policy, what robots do on their own, places that only count."""
