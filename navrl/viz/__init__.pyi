from .animation import save_gif, save_png, save_strip
from .curves import plot_curves
from .failures import save_failures
from .rates import plot_rates
from .rerun_log import save_rrd
from .robustness import plot_robustness
from .scene import draw_scene
from .speeds import plot_benchmark
from .tagd import save_tagd
from .video import save_mp4

__all__ = [
    "draw_scene",
    "plot_benchmark",
    "plot_curves",
    "plot_rates",
    "plot_robustness",
    "save_failures",
    "save_gif",
    "save_mp4",
    "save_png",
    "save_rrd",
    "save_strip",
    "save_tagd",
]
