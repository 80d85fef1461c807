"""Scenarios as data, their generators and named suites, without physics."""

# ruff: noqa: E402 - missing packages are reported before a module that needs them is imported

from navrl.extras import require

require("full", "navrl.worlds", "lazy_loader", "skimage")

import lazy_loader

from navrl.deprecation import renamed_attributes

_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__getattr__ = renamed_attributes(__name__, {"KINDS": "navrl.worlds.batch.KINDS"}, _load)
