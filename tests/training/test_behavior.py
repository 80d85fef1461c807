"""Who acts in which worlds during a training, and what the guide reads."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import Compose

from navrl import keys
from navrl.algos import GaussianExploration
from navrl.config import compose, instantiate
from navrl.envs import NavigationEnv
from navrl.factory import make_env
from navrl.policies import ZOO, load_actor, load_bundle
from navrl.sim import BatchedSimulator, DifferentialDrive, Lidar
from navrl.training import Behavior
from navrl.training.collectors import DirectCollector, Phases
from navrl.worlds import Scenario, ScenarioBatch

WORLDS, GUIDED = 4, 2


def actor(tensordict):
    return tensordict.set(keys.ACTION, torch.full((len(tensordict), 2), 0.5))


class Guide:
    """Write 0.25, 0.26, ...; keep what was read as the last action."""

    def __init__(self):
        self.seen = []

    def __call__(self, tensordict):
        self.seen.append(tensordict.get(keys.ACTION, None))
        action = torch.full((len(tensordict), 2), 0.25 + 0.01 * len(self.seen))
        return tensordict.set(keys.ACTION, action)


def behavior(guide, **kwargs):
    noiseless = GaussianExploration(std=[0.0, 0.0])
    return Behavior(actor, noiseless, guide, guided_fraction=GUIDED / WORLDS, **kwargs)


@pytest.mark.parametrize("random_frames", [0, 100])
def test_guide_reads_its_last_action_not_the_actors_next(random_frames):
    guide = Guide()
    acting = behavior(guide, random_frames=random_frames)
    carrier = TensorDict({}, [WORLDS])
    for _ in range(3):
        carrier = acting.act(carrier, frames=0)
    assert guide.seen[0] is None
    for step, seen in enumerate(guide.seen[1:], start=1):
        torch.testing.assert_close(seen, torch.full((GUIDED, 2), 0.25 + 0.01 * step))
    if not random_frames:
        assert carrier[keys.ACTION][GUIDED:].tolist() == [[0.5, 0.5]] * (WORLDS - GUIDED)


def test_trained_policy_guides_by_its_own_observations():
    cfg = compose("train", ["behavior=guided_by_policy", "experiment=navrl-best"])
    guide = instantiate(cfg.behavior.guide)
    assert guide.in_keys == load_bundle(ZOO / "navrl-best").actor.in_keys
    with pytest.raises(ValueError, match="policy=nobody: must be a bundle or one of"):
        load_actor("nobody")


def test_guide_reads_no_action_of_the_episode_before():
    """World 0 reaches its goal in the first step and begins anew; the others drive on."""
    goals = torch.tensor([[0.3, 0.0], [9.0, 0.0], [9.0, 0.0], [9.0, 0.0]])
    scenes = ScenarioBatch.pack(
        [
            Scenario(
                suite="by hand",
                seed=0,
                index=index,
                kind="corridor",
                boxes=torch.zeros(0, 5).numpy(),
                start=torch.zeros(3).numpy(),
                goal=goal.numpy(),
                path=torch.stack([torch.zeros(2), goal]).numpy(),
                pedestrians=(),
                noise_seed=0,
            )
            for index, goal in enumerate(goals)
        ]
    )

    def build(seed):
        simulator = BatchedSimulator(WORLDS, robot=DifferentialDrive(), lidar=Lidar(num_beams=72))
        env = NavigationEnv(simulator, None, {}, seed=seed)
        env.set_scenarios(scenes)
        return make_env(env, Compose())

    guide = Guide()
    collector = DirectCollector(build, behavior(guide, random_frames=0), seed=0)
    collector.start(0, 0)
    _, stepped = collector.step(0, Phases())
    collector.step(WORLDS, Phases())
    collector.close()
    assert stepped["next", "done"].flatten().tolist() == [True, False, False, False]
    assert not stepped[keys.ACTION].isnan().any()
    assert guide.seen[1][0].isnan().all()
    assert guide.seen[1][1].tolist() == pytest.approx([0.26, 0.26])
