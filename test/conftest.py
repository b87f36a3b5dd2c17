"""Settings of all tests."""

from __future__ import annotations

import os

from hypothesis import settings

# a busy machine is not a failure; the same examples each time, others with HYPOTHESIS_PROFILE=explore
settings.register_profile("project", deadline=None, derandomize=True)
settings.register_profile("explore", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "project"))
