"""Training of the scan flow: loss and figures, the same numbers again, and after a kill."""

import csv
import math
import signal

import pytest
import torch
from test_flow_data import random_samples

from navrl.networks import ScanFlow
from navrl.training import TrainingStoppedError, flow_training
from navrl.training.flow_data import FlowSamples
from navrl.training.flow_loss import FlowLoss, flow_scores
from navrl.training.flow_training import FlowTrainer


def trainer(folder, **options):
    torch.manual_seed(0)
    net = ScanFlow(num_scans=2, channels=4, kernel_size=3, dilations=(1, 2))
    options = {"updates": 12, "batch_size": 4, "evaluate_every_updates": 5} | options
    data = {"samples": random_samples(30), "held_out": random_samples(7, seed=1)} | options
    return FlowTrainer(net, folder=folder, progress_bar=False, **data)


def weights(trained):
    return torch.cat([value.flatten() for value in trained.net.state_dict().values()])


def rows(folder):
    return list(csv.DictReader((folder / "metrics.csv").open()))


def test_loss_is_cross_entropy_and_velocity():
    ranges = torch.zeros(1, 3, 4).half()
    returns = torch.tensor([[True, True, True, False]])
    shown = torch.tensor([[True, True, False, False]])
    velocity = torch.tensor([[[1.0, 0.0], [0.0, 0.1], [0.0, 0.0], [0.0, 0.0]]]).half()
    samples = FlowSamples(ranges, returns, shown, velocity)
    logit = torch.tensor([[0.3, -0.2, 0.5, 9.0]])
    output = torch.tensor([[[1.5, 0.0], [0.0, 0.15], [7.0, 7.0], [7.0, 7.0]]])
    entropy = 2.0 * math.log1p(math.exp(-0.3)) + math.log1p(math.exp(-0.2))
    entropy += math.log1p(math.exp(0.5))
    of_velocity = (0.5 - 0.05) + 0.5 * 0.05**2 / 0.1
    loss = FlowLoss()(logit, output, samples)
    assert float(loss) == pytest.approx(entropy / 3 + 0.5 * of_velocity / 2, abs=1e-3)
    nothing = FlowSamples(ranges, returns & False, shown & False, velocity)
    assert float(FlowLoss()(logit, output, nothing)) == 0.0


class Oracle(torch.nn.Linear):
    """A network that knows the truth of some samples."""

    def __init__(self, samples, error):
        super().__init__(1, 1)
        self.samples, self.error, self.start = samples, error, 0

    def forward(self, ranges, returns):
        part = self.samples[slice(self.start, self.start + len(returns))]
        self.start += len(returns)
        moving = part.velocity.float().norm(dim=-1) > 0.2
        offset = torch.zeros(24, 2)
        offset[:, 0] = torch.linspace(0.0, self.error, 24)  # as many small as large errors
        return moving.float() * 2.0 - 1.0, part.velocity.float() + offset


def test_scores_of_a_perfect_and_of_a_wrong_network():
    samples = random_samples(1100)
    scores = flow_scores(Oracle(samples, 1.0), samples, FlowLoss())
    assert scores["velocity_error_median"] == pytest.approx(0.5, abs=0.05)
    assert scores["velocity_error_q90"] == pytest.approx(0.9, abs=0.05)
    assert (scores["recall"], scores["false_share"]) == (1.0, 0.0)
    still = FlowSamples(samples.ranges, samples.returns, samples.shown & False, samples.velocity)
    scores = flow_scores(Oracle(samples, 0.0), still, FlowLoss())
    assert math.isnan(scores["recall"]) and math.isnan(scores["velocity_error_q90"])
    assert 0.0 < scores["false_share"] < 1.0


def test_same_training_has_the_same_numbers(tmp_path):
    first, again, other = (
        trainer(tmp_path / name, seed=seed) for name, seed in {"a": 0, "b": 0, "c": 1}.items()
    )
    assert first.run() == again.run() != other.run()
    assert torch.equal(weights(first), weights(again))
    assert not torch.equal(weights(first), weights(other))
    assert rows(tmp_path / "a") == rows(tmp_path / "b")
    assert [row["updates"] for row in rows(tmp_path / "a")] == ["5", "10", "12"]
    assert [row["frames"] for row in rows(tmp_path / "a")] == ["20", "40", "48"]


@pytest.mark.parametrize("killed_after", [0, 4, 7, 10])
def test_resumed_training_equals_an_uninterrupted_one(tmp_path, monkeypatch, killed_after):
    whole = trainer(tmp_path / "a")
    scores = whole.run()
    monkeypatch.setattr(flow_training, "CHECKPOINT_EVERY_S", 0.0)
    killed = trainer(tmp_path / "b")
    update = killed._update

    def kill():
        if killed.done == killed_after:
            raise MemoryError
        return update()

    monkeypatch.setattr(killed, "_update", kill)
    with pytest.raises(MemoryError):
        killed.run()
    resumed = trainer(tmp_path / "b")
    assert resumed.run() == scores and torch.equal(weights(resumed), weights(whole))
    assert rows(tmp_path / "b") == rows(tmp_path / "a")
    assert trainer(tmp_path / "b").run() == scores  # finished, so only scored


def test_signal_saves_the_training(tmp_path, monkeypatch):
    scores = trainer(tmp_path / "a").run()
    stopped = trainer(tmp_path / "b")
    update = stopped._update

    def interrupted():
        if stopped.done == 6:
            signal.raise_signal(signal.SIGTERM)
        return update()

    monkeypatch.setattr(stopped, "_update", interrupted)
    message = "stopped by SIGTERM after 7 of 12 updates; saved, the same command continues"
    with pytest.raises(TrainingStoppedError, match=message):
        stopped.run()
    assert trainer(tmp_path / "b").run() == scores


def test_network_learns_a_moving_range(tmp_path):
    samples = random_samples(200)
    moved = samples.ranges.clone()
    moved[:, 1] = torch.where(samples.shown, moved[:, 0] - 0.4, moved[:, 0])
    moved[:, 2] = moved[:, 1]
    speed = torch.tensor([1.0, 0.0]).half() * samples.shown[..., None]
    data = FlowSamples(moved, samples.returns, samples.shown, speed)
    learner = trainer(tmp_path, samples=data, held_out=data, updates=300, learning_rate=0.02)
    scores = learner.run()
    assert scores["velocity_error_q90"] < 0.2
    assert scores["recall"] > 0.98 and scores["false_share"] < 0.02
    rate = learner._optimizer.param_groups[0]["lr"]
    assert rate == pytest.approx(0.02 * (1.0 - 0.98 * 299 / 300))


@pytest.mark.parametrize(
    "options, message",
    [
        ({"updates": 0}, "updates=0: must be an integer, at least 1"),
        ({"batch_size": 1.5}, "batch_size=1.5: must be an integer"),
        ({"learning_rate": -1.0}, "learning_rate=-1.0: must be positive"),
        ({"held_out": random_samples(1)[slice(0, 0)]}, "held_out: must have at least one sample"),
    ],
)
def test_wrong_arguments_of_the_training_are_named(tmp_path, options, message):
    with pytest.raises(ValueError, match=message):
        trainer(tmp_path, **options)


def test_wrong_weights_of_the_loss_are_named():
    with pytest.raises(ValueError, match=r"beta=0\.0: must be positive"):
        FlowLoss(beta=0.0)


def test_loss_that_is_not_finite_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"learning_rate=1e\+30: the loss is not finite after"):
        trainer(tmp_path, learning_rate=1e30).run()
