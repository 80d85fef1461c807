"""A training starts from the weights of a bundle or of a run."""

import logging

import pytest
import torch
from runs import TINY, tiny_trainer

from navrl import factory
from navrl.config import compose
from navrl.factory.environment import make_training_env
from navrl.factory.warm_start import matching_layers, start_actor

WORDS = [word for word in TINY if word != "network=small"]


def agent(cfg):
    env = make_training_env(cfg, seed=0, num_worlds=1)
    shapes = factory.observation_shapes(env)
    env.close()
    return factory.make_agent(cfg, shapes)[0]


def test_actor_starts_with_the_weights_of_the_zoo(caplog):
    cfg = compose("train", [*WORDS, "experiment=paper", "warm_start=paper"])
    actor = agent(cfg)
    before = {name: value.clone() for name, value in actor.state_dict().items()}
    with caplog.at_level(logging.INFO):
        start_actor(cfg, actor)
    assert not any(torch.equal(before[name], value) for name, value in actor.state_dict().items())
    assert "initialized: none" in caplog.text


def test_bundle_that_does_not_fit_is_named(tmp_path):
    cfg = compose("train", [*WORDS, "network=small", "warm_start=nowhere"])
    actor = agent(cfg)
    with pytest.raises(ValueError, match="warm_start=nowhere: must be null"):
        start_actor(cfg, actor)
    cfg.warm_start = "perez_darpino"
    with pytest.raises(ValueError, match="must have a layer of the same name and shapes"):
        start_actor(cfg, actor)


def test_layers_match_as_a_whole():
    layer = {"0.weight": torch.ones(2, 3), "0.bias": torch.ones(2), "1.bias": torch.ones(1)}
    other = {**layer, "0.weight": torch.ones(3, 3)}
    assert list(matching_layers(layer, other)) == ["1.bias"]


def test_inputs_appended_to_a_layer_have_zero_weights():
    layer = {"0.weight": torch.ones(2, 3), "0.bias": torch.ones(2)}
    wider = matching_layers(layer, {**layer, "0.weight": torch.full((2, 5), 7.0)})
    assert wider["0.weight"].tolist() == [[1.0, 1.0, 1.0, 0.0, 0.0]] * 2
    assert not matching_layers(layer, {**layer, "0.weight": torch.ones(2, 2)})


def test_run_gives_actor_and_critic(tmp_path):
    first = tiny_trainer(tmp_path / "first", ["schedule.total_frames=80"])
    first.run()
    second = tiny_trainer(tmp_path / "second", [f"warm_start={tmp_path / 'first'}", "seed=1"])
    own, saved = second.algorithm.state_dict()["loss"], first.algorithm.state_dict()["loss"]
    critic = [
        name for name in saved if "value_network_params" in name and torch.is_tensor(saved[name])
    ]
    assert critic and all(torch.equal(own[name], saved[name]) for name in critic)
    second.collector.close()
