"""Composition root: builds all objects from a resolved configuration."""

# ruff: noqa: E402 - missing packages are reported before a module that needs them is imported

from navrl.extras import require

require("full", "navrl.factory", "hydra", "lazy_loader", "safetensors", "skimage", "tqdm", "yaml")

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
