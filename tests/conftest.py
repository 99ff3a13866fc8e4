"""Settings that all tests share."""

import os

from hypothesis import settings

# No deadline: a shared machine pauses any example now and then.
settings.register_profile("here", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("ci" if os.environ.get("CI") == "true" else "here")
