"""Pictures from files: an episode, a trainer's log, a benchmark. Nothing here simulates."""

from navrl.viz.animation import save_gif, save_png, save_strip
from navrl.viz.curves import plot_curves
from navrl.viz.scene import draw_scene
from navrl.viz.speeds import plot_benchmark

__all__ = ["draw_scene", "plot_benchmark", "plot_curves", "save_gif", "save_png", "save_strip"]
