"""Lidar navigation among pedestrians, learned with spatiotemporal attention.

Importing the package registers ``navrl/Navigation-v0`` with gymnasium and loads nothing else.
"""

import gymnasium

__version__ = "0.1.0"

gymnasium.register(id="navrl/Navigation-v0", entry_point="navrl.factory:make_gymnasium_env")
