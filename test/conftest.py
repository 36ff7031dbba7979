"""What all tests have in common: none of them times speed, since the machine may be busy."""

import gc

from hypothesis import HealthCheck, settings

settings.register_profile("any", deadline=None, suppress_health_check=[HealthCheck.too_slow])
# for what has run with 100 before
settings.register_profile("libraries", settings.get_profile("any"), max_examples=12)
settings.load_profile("any")


def pytest_collection_finish():
    # to look for reference cycles among all that the tests import, again and again, takes a tenth of their time; and as
    # often as Python does by itself among what they make, a twentieth
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 20, 20)
