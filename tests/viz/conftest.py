"""A real episode, recorded once for all pictures."""

import pytest
import torch
from tensordict.nn import TensorDictSequential

from navrl.build import make_env, make_navigation_env, observation_shapes
from navrl.config import compose, instantiate
from navrl.evaluation.recording import record_episode
from navrl.networks import make_actor
from navrl.policies.classical import PurePursuit


@pytest.fixture(scope="session")
def recording():
    """Pure pursuit in an intersection, with the attention of an untrained actor."""
    cfg = compose("train", ["scenario=intersection", "network=small"])
    env = make_env(make_navigation_env(cfg, 1, privileged=True), instantiate(cfg.transforms))
    torch.manual_seed(0)
    encoder = instantiate(cfg.network.encoder)
    actor = make_actor(encoder, observation_shapes(env), with_attention=True)
    policy = TensorDictSequential(actor, PurePursuit(env.base_env.simulator.robot))
    scenario = instantiate(cfg.scenario).sample("pictured", 0, 1)
    yield record_episode(env, policy, scenario)
    env.close()
