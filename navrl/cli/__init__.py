"""Entry points of the installed commands."""

import sys

from navrl.extras import require

try:
    require("full", "the commands", "hydra", "matplotlib", "safetensors", "skimage", "tqdm", "yaml")
except ModuleNotFoundError as error:
    sys.exit(f"navrl: {error}")
