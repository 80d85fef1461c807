"""Pictures from files: a recorded episode, a trainer's log. Nothing here runs a simulation."""

from navrl.viz.animation import save_gif, save_png, save_strip
from navrl.viz.curves import plot_curves
from navrl.viz.scene import draw_scene

__all__ = ["draw_scene", "plot_curves", "save_gif", "save_png", "save_strip"]
