"""Loggers of a training run: TensorBoard, CSV, Weights & Biases, MLflow and Trackio."""

from navrl.training.loggers.local import CSV, TensorBoard
from navrl.training.loggers.mirror import Loggers, RunLogger
from navrl.training.loggers.trackers import MLflow, Trackio, WandB

__all__ = ["CSV", "Loggers", "MLflow", "RunLogger", "TensorBoard", "Trackio", "WandB"]
