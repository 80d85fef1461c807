"""A training that takes seconds."""

from navrl import factory
from navrl.config import compose

TINY = [
    "num_worlds=4",
    "num_threads=1",
    "pool_size=4",
    "scenario=corridor",
    "network=small",
    "replay.batch_size=8",
    "replay.capacity=300",
    "behavior.random_frames=20",
    "validation.num_episodes=4",
    "environment.time_limit_steps=12",
    "schedule.total_frames=480",
    "schedule.learning_starts=40",
    "schedule.frames_per_update=8",
    "schedule.evaluate_every_updates=20",
    "schedule.log_every_updates=10",
    "schedule.checkpoint_every_s=0.001",
    "progress_bar=false",
]


def tiny_trainer(folder, overrides=()):
    cfg = compose("train", [*TINY, *overrides])
    factory.set_threads(cfg)
    return factory.make_trainer(cfg, folder)
