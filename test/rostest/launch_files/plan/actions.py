"""The only action of the plan."""


def work(is_cancelled):
    """Take a moment."""
    is_cancelled.wait(0.2)
