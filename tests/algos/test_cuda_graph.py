"""A recorded update is the eager one; what surrounds the recording is tried on the CPU too."""

from copy import deepcopy
from functools import partial

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

from navrl.algos import DDPG, TD3, NonFiniteUpdateError
from navrl.algos.cuda_graph import CapturedUpdates


class Score(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.net = torch.nn.Sequential(
            torch.nn.Linear(6, 16), torch.nn.ELU(), torch.nn.Linear(16, 1)
        )

    def forward(self, observation, action):
        return self.net(torch.cat([observation, action], -1))


def make_learner(device="cpu", algorithm=DDPG, **options):
    torch.manual_seed(0)
    policy = torch.nn.Sequential(torch.nn.Linear(4, 16), torch.nn.Linear(16, 2), torch.nn.Tanh())
    actor = TensorDictModule(policy, ["observation"], ["action"]).to(device)
    critic = TensorDictModule(Score(), ["observation", "action"], ["state_action_value"])
    options = {"tau": 0.05, "actor_learning_rate": 0.01, "final_learning_rate_scale": 0.1} | options
    return algorithm(actor, critic.to(device), **options)


def make_batch(seed, device="cpu", size=8):
    generator = torch.Generator().manual_seed(seed)
    draw = lambda *shape: torch.randn(size, *shape, generator=generator)  # noqa: E731
    ended = draw(1) > 1
    following = {"observation": draw(4), "reward": draw(1), "done": ended, "terminated": ended}
    following = TensorDict(following, [size])
    batch = {"observation": draw(4), "action": draw(2).tanh(), "next": following}
    return TensorDict(batch, [size]).to(device)


def guarded(learner):
    """Put the recording's update into a learner on the CPU, where it is never recorded."""
    learner._captured = learner._make_captured(0.05)
    return learner


def numbers(learner):
    return [
        *(weight.detach().cpu().clone() for weight in learner.loss.parameters()),
        *(buffer.cpu().clone() for _, buffer in learner.loss.named_buffers()),
        *(
            v.cpu().clone()
            for o in learner._optimizers
            for s in o[0].state.values()
            for v in s.values()
        ),
    ]


def assert_alike(learner, other):
    one, two = numbers(learner), numbers(other)
    assert len(one) == len(two) > 20
    for left, right in zip(one, two, strict=True):
        torch.testing.assert_close(left, right, atol=1e-6, rtol=1e-5)


def assert_updates_alike(learner, reference, device, count=8):
    for seed in range(count):
        batch, copy = make_batch(seed, device), make_batch(seed, device)
        for one in (learner, reference):
            one.anneal(seed / count)
        scalars, expected = learner.update(batch), reference.update(copy)
        assert scalars.keys() == expected.keys()
        for name, value in scalars.items():
            torch.testing.assert_close(value, expected[name], atol=1e-5, rtol=1e-4)
    assert_alike(learner, reference)


def assert_many_are_one_by_one(learner, reference, device):
    """Fewer batches than are copied at a time, more, and as many again."""
    for seed, count in enumerate((3, 70, 64)):
        batches = torch.stack([make_batch(100 * seed + k, device) for k in range(count)])
        sums = learner.update_from_each(batches.clone())
        expected = [reference.update(batch) for batch in batches.unbind(0)]
        for name, value in sums.items():
            total = sum(scalars[name] for scalars in expected)
            torch.testing.assert_close(value, total, atol=1e-3, rtol=1e-3)
    for one, two in zip(numbers(learner), numbers(reference), strict=True):
        torch.testing.assert_close(one, two, atol=1e-4, rtol=1e-3)


def update_and_save(learner, batches):
    for batch in batches:
        learner.update(batch.clone())
    learner.state_dict()


def assert_stops_at_what_is_not_finite(learner, device):
    for seed in range(5):
        learner.update(make_batch(seed, device))
    before, bad = numbers(learner), make_batch(9, device)
    bad["next", "reward"][3] = torch.nan
    batches = [bad, *(make_batch(seed, device) for seed in range(200))]
    with pytest.raises(NonFiniteUpdateError) as error:
        update_and_save(learner, batches)
    assert all(map(torch.equal, before, numbers(learner)))
    assert torch.isnan(error.value.terms["loss_critic"])
    torch.testing.assert_close(
        error.value.batch["next", "reward"], bad["next", "reward"], equal_nan=True
    )
    learner.state_dict()  # is told once: what is told is to be saved


def test_guarded_update_equals_the_plain_update():
    assert_updates_alike(guarded(make_learner()), make_learner(), "cpu")


@pytest.mark.parametrize(
    "algorithm", [DDPG, pytest.param(partial(TD3, target_noise=0.0), marks=pytest.mark.slow)]
)
def test_batched_updates_equal_single_updates(algorithm):
    learner = guarded(make_learner(algorithm=algorithm))
    assert_many_are_one_by_one(learner, make_learner(algorithm=algorithm), "cpu")
    plain = make_learner(algorithm=algorithm)
    assert_many_are_one_by_one(plain, make_learner(algorithm=algorithm), "cpu")


def test_failing_batch_is_identified_among_many():
    learner, reference = guarded(make_learner()), make_learner()
    batches = torch.stack([make_batch(seed) for seed in range(6)])
    for batch in batches[:4].unbind(0):
        reference.update(batch)
    batches["next", "reward"][4, 2] = torch.inf
    learner.update_from_each(batches)
    with pytest.raises(NonFiniteUpdateError) as error:
        learner.state_dict()
    assert torch.isinf(error.value.batch["next", "reward"][2])
    assert_alike(learner, reference)


def test_weights_are_unchanged_after_a_non_finite_update():
    assert_stops_at_what_is_not_finite(guarded(make_learner()), "cpu")


def test_scalar_settings_are_unchanged():
    learner = guarded(make_learner())
    scalars = learner.update(make_batch(0))
    before = deepcopy(scalars)
    learner.update(make_batch(1))
    assert scalars == before


def test_learner_continues_after_loading():
    learner, reference = guarded(make_learner()), make_learner()
    for seed in range(3):
        reference.update(make_batch(seed))
    learner.load_state_dict(reference.state_dict())
    assert_updates_alike(learner, reference, "cpu")


def test_batch_of_another_shape_is_rejected():
    learner = guarded(make_learner())
    learner.update(make_batch(0))
    with pytest.raises(ValueError, match=r"'observation' was \[8, 4\]"):
        learner.update(make_batch(0, size=4))


@pytest.mark.parametrize("saved, own", [(True, False), (False, True)])
def test_fused_and_plain_adam_load_each_others_state(saved, own):
    one, other = make_learner(fused_optimizer=saved), make_learner(fused_optimizer=own)
    assert one.actor_optimizer.param_groups[0]["fused"] is saved
    one.anneal(0.5)
    for seed in range(3):
        one.update(make_batch(seed))
    other.load_state_dict(one.state_dict())
    assert other.actor_optimizer.param_groups[0]["fused"] is own
    assert other.actor_optimizer.param_groups[0]["lr"] == one.actor_optimizer.param_groups[0]["lr"]
    assert_updates_alike(other, one, "cpu")


def test_a_graph_needs_a_cuda_device():
    with pytest.raises(
        ValueError, match=r"cuda_graph=True: needs .* they are on cpu; set device=cuda"
    ):
        make_learner(cuda_graph=True)


@pytest.mark.gpu
@pytest.mark.parametrize("precision", ["float32", "tfloat32", "bfloat16"])
def test_captured_update_equals_the_eager_update(precision):
    learner = make_learner("cuda", cuda_graph=True, precision=precision)
    assert_updates_alike(learner, make_learner("cuda", precision=precision), "cuda")
    assert learner._captured.is_recorded


@pytest.mark.gpu
@pytest.mark.parametrize("algorithm", [DDPG, partial(TD3, target_noise=0.0)])
def test_captured_batched_updates_equal_single_updates(algorithm):
    learner = make_learner("cuda", algorithm, cuda_graph=True)
    assert_many_are_one_by_one(learner, make_learner("cuda", algorithm), "cuda")
    assert len(learner._captured._graphs) == (1 if algorithm is DDPG else 2)


@pytest.mark.gpu
def test_captured_update_stops_at_non_finite_values():
    assert_stops_at_what_is_not_finite(make_learner("cuda", cuda_graph=True), "cuda")


@pytest.mark.gpu
@pytest.mark.parametrize("source, target", [("cpu", "cuda"), ("cuda", "cpu"), ("cuda", "cuda")])
def test_a_state_moves_between_devices(source, target):
    one = make_learner(source, cuda_graph=source == "cuda")
    for seed in range(6):
        one.update(make_batch(seed, source))
    other = make_learner(target, cuda_graph=target == "cuda")
    for seed in range(6):
        other.update(make_batch(seed + 10, target))  # recorded before it loads
    other.load_state_dict(one.state_dict())
    assert_alike(other, one)
    for seed in range(6):
        one.update(make_batch(seed, source))
        other.update(make_batch(seed, target))
    for left, right in zip(numbers(one), numbers(other), strict=True):
        torch.testing.assert_close(left, right, atol=1e-4, rtol=1e-3)


def test_capture_uses_the_learners_own_memory():
    learner = guarded(make_learner())
    captured: CapturedUpdates = learner._captured
    online = {w.data_ptr() for w in learner.loss.parameters()}
    assert {w.data_ptr() for w in captured._weights} == online
    assert not online & {w.data_ptr() for w in captured._targets}
    learner.load_state_dict(make_learner().state_dict())
    assert {w.data_ptr() for w in learner.loss.parameters()} == online
