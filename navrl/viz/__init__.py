"""Pictures of episodes, training logs and benchmarks, drawn from files without simulation."""

from navrl.viz.animation import save_gif, save_png, save_strip
from navrl.viz.curves import plot_curves
from navrl.viz.failures import save_failures
from navrl.viz.rates import plot_rates
from navrl.viz.rerun_log import save_rrd
from navrl.viz.scene import draw_scene
from navrl.viz.speeds import plot_benchmark
from navrl.viz.tagd import save_tagd
from navrl.viz.video import save_mp4

__all__ = [
    "draw_scene",
    "plot_benchmark",
    "plot_curves",
    "plot_rates",
    "save_failures",
    "save_gif",
    "save_mp4",
    "save_png",
    "save_rrd",
    "save_strip",
    "save_tagd",
]
