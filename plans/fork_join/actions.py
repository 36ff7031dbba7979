"""Work that takes a moment; what follows is the place's only transition, or the policy's choice."""


def work(is_cancelled):
    """Work."""
    is_cancelled.wait(0.2)
