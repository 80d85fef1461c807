"""Training: trainer, collectors, replay, curriculum, checkpoints and logs."""

from navrl.training.behaviour import Behaviour
from navrl.training.checkpoint import CheckpointError, CheckpointStore
from navrl.training.collectors import Collector, DirectCollector
from navrl.training.curriculum import Curriculum
from navrl.training.engines import DistributedCollector, ProcessCollector, RayCollector
from navrl.training.interruption import TrainingStoppedError
from navrl.training.metrics_log import MetricsLog
from navrl.training.replay import Replay
from navrl.training.schedule import Progress, Schedule
from navrl.training.trainer import Trainer

__all__ = [
    "Behaviour",
    "CheckpointError",
    "CheckpointStore",
    "Collector",
    "Curriculum",
    "DirectCollector",
    "DistributedCollector",
    "MetricsLog",
    "ProcessCollector",
    "Progress",
    "RayCollector",
    "Replay",
    "Schedule",
    "Trainer",
    "TrainingStoppedError",
]
