"""What every transform of navrl promises, as tests to inherit.

A transform of your own is held to the same promises by a subclass::

    class TestMyTransform(TransformContract):
        def make(self, **kwargs):
            return MyTransform(**kwargs)
"""

from __future__ import annotations

import pickle
from functools import partial

import pytest
import torch
from lidar_envs import RoomEnv, StrangersEnv
from nightly import mostly
from tensordict import TensorDict, TensorDictBase
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.envs import (
    Compose,
    EnvBase,
    GymWrapper,
    ParallelEnv,
    SerialEnv,
    Transform,
    TransformedEnv,
)
from torchrl.envs.utils import check_env_specs, step_mdp

# Devices that .to is tried with; "cuda" joins where there is one.
DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]


def make_env(steps: list[Transform], num_worlds: int = 4) -> EnvBase:
    return TransformedEnv(RoomEnv(num_worlds), Compose(*(step.clone() for step in steps)))


def assert_same(left: TensorDictBase, right: TensorDictBase, keys, tolerance: float = 0.0) -> None:
    for key in keys:
        kind = {"rtol": tolerance, "atol": tolerance}
        torch.testing.assert_close(
            left[key], right[key], **kind, msg=lambda text, key=key: f"{key}: {text}"
        )


class TransformContract:
    """Subclass, and say what to make and what must come before it."""

    # Whether all outputs follow from inputs of the same time.
    is_memoryless = True
    # Entries that a step reads from its caller, if there are any.
    state_keys = ()
    # Whether it has weights, which are neither trained nor saved.
    has_constants = False
    # Between batches of another size; torch rounds differently at the tail of its vectors.
    tolerance = 0.0

    def make(self, **keys) -> Transform:
        """Return the transform; ``keys`` may be in_keys and out_keys."""
        raise NotImplementedError

    def before(self) -> list[Transform]:
        """Return the transforms whose outputs this one reads, for the RoomEnv."""
        return []

    def in_foreign_env(self) -> list[Transform]:
        """Return the whole chain for the StrangersEnv; this one last, with a nested out_key."""
        raise NotImplementedError

    def check_rollout(self, rollout: TensorDictBase) -> None:
        """Assert what is true of the outputs in each transition ``[N, T]``."""
        transform = self.make()
        for part in (rollout, rollout["next"]):
            again = transform(part.select(*transform.in_keys))
            assert_same(again, part, transform.out_keys, self.tolerance)

    def steps(self) -> list[Transform]:
        return [*self.before(), self.make()]

    def rollout(self, num_steps: int = 12, seed: int = 0) -> TensorDictBase:
        env = make_env(self.steps())
        env.set_seed(seed)
        torch.manual_seed(seed)
        return env.rollout(num_steps, break_when_any_done=False)

    def test_specs_match_outputs(self):
        check_env_specs(make_env(self.steps()))

    def test_outputs_have_the_declared_dtypes(self):
        rollout = self.rollout()
        for key in self.make().out_keys:
            assert rollout[key].dtype in (torch.float32, torch.bool, torch.int64), key
            assert rollout[key].dtype == rollout["next", key].dtype

    def test_rollout_with_ragged_resets(self):
        rollout = self.rollout(num_steps=30)
        assert rollout["next", "done"].any()
        assert not rollout["next", "done"].all()
        self.check_rollout(rollout)

    def test_partial_reset_leaves_other_rows_alone(self):
        env = make_env(self.steps())
        env.set_seed(3)
        torch.manual_seed(3)
        tensordict = env.rollout(3, break_when_any_done=False)[:, -1]
        tensordict = step_mdp(tensordict)
        mask = torch.tensor([[True], [False], [True], [False]])
        after = env.reset(tensordict.clone().set("_reset", mask))
        fresh = self.make()
        for key in fresh.out_keys:
            untouched = ~mask.squeeze(-1)
            torch.testing.assert_close(after[key][untouched], tensordict[key][untouched])
        if self.is_memoryless:
            again = fresh(after.select(*fresh.in_keys))
            assert_same(again, after, fresh.out_keys)

    def test_step_shares_no_memory_with_its_input(self):
        """Workers of a ParallelEnv overwrite the root in place after the step."""
        env = make_env(self.steps())
        env.set_seed(0)
        root = env.reset()
        root["action"] = torch.full((4, 2), 0.5)
        following = env.step(root)["next"]
        kept = following.clone()
        for value in root.exclude("next").values(True, True):
            value.zero_() if value.dtype == torch.bool else value.fill_(7)
        assert_same(following, kept, self.make().out_keys)

    def test_outputs_share_no_memory(self):
        """Writing to one key later must not change another."""
        root = make_env(self.steps()).reset()
        out_keys = self.make().out_keys
        others = {key: root[key].data_ptr() for key in root.keys(True, True)}
        for key in out_keys:
            address = others.pop(key)
            assert address not in others.values(), key

    @pytest.mark.parametrize("kind", mostly([SerialEnv, ParallelEnv], [SerialEnv]))
    def test_workers_give_equal_outputs(self, kind):
        """The transform gives the same inside the workers as around them."""
        inside = kind(2, partial(make_env, self.steps()), **_fast_start(kind))
        outside = TransformedEnv(
            kind(2, partial(make_env, []), **_fast_start(kind)), Compose(*self.steps())
        )
        rollouts = []
        for env in (inside, outside):
            env.set_seed(5)
            torch.manual_seed(5)
            rollouts.append(env.rollout(15, break_when_any_done=False))
            env.close(raise_if_closed=False)
        keys = self.make().out_keys
        keys = [*keys, *(("next", key) for key in keys)]
        assert_same(rollouts[0], rollouts[1], keys, self.tolerance)
        self.check_rollout(rollouts[0])

    def test_workers_step_from_the_callers_state(self):
        """Not from their own last step: planning and replayed states need it."""
        if not self.state_keys:
            return
        results = []
        for kind in (SerialEnv, ParallelEnv):
            env = kind(2, partial(make_env, self.steps()), **_fast_start(kind))
            env.set_seed(1)
            root = env.reset()
            for key in self.state_keys:
                state = root[key]
                root[key] = ~state if state.dtype == torch.bool else state + 0.5
            root["action"] = torch.zeros(2, 4, 2)
            results.append((root, env.step(root.clone())["next"]))
            env.close(raise_if_closed=False)
        for root, following in results:
            data = root.reshape(8).select(*self.state_keys)
            data["next"] = following.reshape(8).exclude(*self.make().out_keys)
            expected = self.make()._step(data, data["next"])
            assert_same(following.reshape(8), expected, self.make().out_keys, self.tolerance)

    def test_replay_buffer_restores_next(self):
        """What the buffer did not store is made again at sampling, as it was."""
        online = self.rollout().reshape(-1)
        transform = self.make()
        drop = [("next", key) for key in transform.out_keys]
        if self.is_memoryless:
            drop += transform.out_keys
        buffer = ReplayBuffer(
            storage=LazyTensorStorage(len(online)), transform=transform, batch_size=16
        )
        online["row"] = torch.arange(len(online))
        buffer.extend(online.exclude(*drop))
        sample = buffer.sample()
        expected = online[sample["row"]]
        assert_same(sample, expected, [*drop, *transform.out_keys], self.tolerance)

    def test_any_batch_shape(self):
        rollout = self.rollout()[:4, :6].exclude("next")
        transform = self.make()
        inputs = rollout.select(*transform.in_keys)
        whole = transform(inputs.clone())
        assert whole[transform.out_keys[0]].shape[:2] == (4, 6)
        flat = transform(inputs.reshape(-1).clone())
        assert_same(whole.reshape(-1), flat, transform.out_keys, self.tolerance)
        single = transform(inputs[1, 2].clone())
        for key in transform.out_keys:
            torch.testing.assert_close(single[key], whole[key][1, 2])

    def test_clone_and_pickle(self):
        transform = self.make()
        inputs = self.rollout()[:, :2].select(*transform.in_keys)
        expected = transform(inputs.clone())
        env = make_env([*self.before(), transform])  # a transform that has a parent
        for copy in (transform.clone(), pickle.loads(pickle.dumps(self.make()))):
            assert copy.parent is None
            assert_same(copy(inputs.clone()), expected, transform.out_keys)
        assert not list(transform.parameters())
        assert bool(list(transform.buffers())) is self.has_constants
        assert not transform.state_dict()
        env.close()

    @pytest.mark.parametrize("device", DEVICES)
    def test_device_move(self, device):
        transform = self.make().to(device)
        inputs = self.rollout()[:, :3].select(*transform.in_keys)
        on_cpu = self.make()(inputs.clone())
        moved = transform(inputs.to(device))
        for key in transform.out_keys:
            assert moved[key].device.type == device
            torch.testing.assert_close(moved[key].cpu(), on_cpu[key], rtol=1e-4, atol=1e-4)
        env = make_env(self.steps()).to(device)
        assert env.rollout(2)[transform.out_keys[0]].device.type == device

    def test_foreign_env(self):
        env = TransformedEnv(GymWrapper(StrangersEnv()), Compose(*self.in_foreign_env()))
        check_env_specs(env)
        env.set_seed(0)
        rollout = env.rollout(20, break_when_any_done=False)
        out_keys = env.transform[-1].out_keys
        assert any(isinstance(key, tuple) for key in out_keys), "use a nested key here"
        for key in out_keys:
            assert rollout[key].dtype != torch.float64
            assert not rollout["next", key].to(torch.float32).isnan().any()

    def test_missing_key_is_named(self):
        transform = self.make()
        with pytest.raises(ValueError, match=repr(transform.in_keys[0])):
            transform(TensorDict({"other": torch.zeros(2, 3)}, [2]))
        keys = ["no_such_key"] * len(transform.in_keys)
        env = make_env([*self.before(), self.make(in_keys=keys)])
        with pytest.raises(ValueError, match="no_such_key"):
            _ = env.observation_spec

    def test_keys_come_from_yaml_lists(self):
        transform = self.make()
        nested = [["group", f"k{index}"] for index, _ in enumerate(transform.out_keys)]
        assert self.make(out_keys=nested).out_keys == [tuple(key) for key in nested]


def _fast_start(kind: type) -> dict:
    """Fork workers: spawning would import torch in each of them."""
    return {"mp_start_method": "fork"} if kind is ParallelEnv else {}
