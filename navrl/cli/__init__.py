"""Entry points of the installed commands."""

import sys

from navrl.extras import require

try:
    packages = ("hydra", "lazy_loader", "matplotlib", "safetensors", "skimage", "tqdm", "yaml")
    require("full", "the commands", *packages)
except ModuleNotFoundError as error:
    sys.exit(f"navrl: {error}")
