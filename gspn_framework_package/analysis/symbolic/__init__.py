"""The reachable markings of a bounded net as a decision diagram: exact counts of more of them than
could be visited.

``markings`` counts, and ``answers`` puts the counts into a report; ``ordering`` finds promising
orders of the places; ``steps`` turns the net into steps of diagrams, which ``kernel`` takes, in one
of the forms of ``machine``.
"""
