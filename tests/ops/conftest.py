"""Properties are tried on the same examples in every run, however slow the machine."""

import sys
from pathlib import Path

from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent))  # tests import their neighbor rooms.py

settings.register_profile("navrl", deadline=None, derandomize=True)
settings.load_profile("navrl")
