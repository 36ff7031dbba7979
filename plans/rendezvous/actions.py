"""Pickers and carriers: each action takes its time, and the place's only transition follows."""

import random


def fetch(is_cancelled):
    """Take a parcel from the shelf."""
    is_cancelled.wait(random.uniform(0.4, 1.0))


def approach(is_cancelled):
    """Drive to the dock."""
    is_cancelled.wait(random.uniform(0.4, 1.0))


def hand_over(is_cancelled):
    """Get ready at the dock; the transition waits for the partner."""
    is_cancelled.wait(0.2)


def drive_back(is_cancelled):
    """Drive back to the shelf without a parcel."""
    is_cancelled.wait(random.uniform(0.3, 0.6))


def deliver(is_cancelled):
    """Deliver the parcel."""
    is_cancelled.wait(random.uniform(0.5, 1.2))


def charge(is_cancelled):
    """Charge; the charger is this robot's until it unplugs."""
    is_cancelled.wait(0.5)
