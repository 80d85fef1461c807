"""Training: trainer, collectors, replay, curriculum, checkpoints and logs."""

from navrl.deprecation import renamed_attributes
from navrl.training.behavior import Behavior
from navrl.training.checkpoint import CheckpointError, CheckpointStore
from navrl.training.collectors import Collector, DirectCollector
from navrl.training.curriculum import Curriculum
from navrl.training.engines import DistributedCollector, ProcessCollector, RayCollector
from navrl.training.interruption import TrainingStoppedError
from navrl.training.metrics_log import MetricsLog
from navrl.training.replay import Replay
from navrl.training.rollouts import Rollouts
from navrl.training.schedule import Progress, Schedule
from navrl.training.trainer import Trainer

__all__ = [
    "Behavior",
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
    "Rollouts",
    "Schedule",
    "Trainer",
    "TrainingStoppedError",
]

__getattr__ = renamed_attributes(__name__, {"Behaviour": "navrl.training.behavior.Behavior"})
