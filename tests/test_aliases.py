"""Names of the release before resolve to their new homes, with a deprecation warning."""

import sys
import warnings
from functools import partial
from importlib import import_module
from types import SimpleNamespace
from unittest import mock

import pytest
import torch
from evaluated import HIT, WON, write_evaluation
from nightly import mostly
from omegaconf import OmegaConf
from tensordict import TensorDict

import navrl.build
from navrl import factory, jobs
from navrl.algos import GaussianExploration
from navrl.config import compose, instantiate
from navrl.deprecated_groups import renamed_overrides
from navrl.deprecation import (
    RENAMED_INPUTS,
    input_key,
    renamed_arguments,
    taken_argument,
)
from navrl.evaluation import compare, find_evaluations, metrics_markdown
from navrl.factory.policy import make_runner, with_controller
from navrl.factory.training import make_collector
from navrl.jobs import claim_folder, resumed_config
from navrl.networks import AttentionStream, CriticNetwork, StreamEncoder, VectorStream, make_critic
from navrl.policies import ZOO, load_bundle, zoo_names
from navrl.policies.classical import DynamicWindow, SearchEffort
from navrl.sim import Contact, DifferentialDrive, Simulator
from navrl.training import Behavior, DirectCollector
from navrl.transforms import ActionShield

MOVED = {
    "navrl.config.hydra_main": "navrl.cli.command.hydra_main",
    "navrl.evaluation.metrics.run_into": "navrl.evaluation.metrics.hit_by_pedestrian",
    "navrl.training.Behaviour": "navrl.training.behavior.Behavior",
    "navrl.training.behaviour.Behaviour": "navrl.training.behavior.Behavior",
    "navrl.keys.WAYPOINT_INPUT": "navrl.keys.WAYPOINTS_SCALED",
    "navrl.networks.restraint.restrain": "navrl.networks.saturation.penalize_saturation",
    "navrl.ops.contact.RUN_INTO": "navrl.ops.contact.HIT_BY_PEDESTRIAN",
    "navrl.ops.contact.blame": "navrl.ops.contact.classify_contact",
    "navrl.ops.scan_layout.TURN": "navrl.ops.scan_layout.TWO_PI",
    "navrl.worlds.KINDS": "navrl.worlds.batch.KINDS",
}


def find(name: str) -> object:
    module, _, attribute = name.rpartition(".")
    return getattr(import_module(module), attribute)


@pytest.mark.parametrize(
    "old, new",
    [
        ("make_env", factory.make_env),
        ("run_evaluation", jobs.run_evaluation),
        ("Contender", factory.EvaluatedPolicy),
        ("make_contender", factory.make_evaluated_policy),
    ],
)
def test_old_build_names_warn_and_resolve(old, new):
    with pytest.warns(DeprecationWarning, match=f"navrl.build.{old} is deprecated"):
        assert getattr(navrl.build, old) is new


def test_unknown_build_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = navrl.build.no_such_name


@pytest.mark.parametrize("old, new", MOVED.items())
def test_renamed_attributes_warn_and_resolve(old, new):
    with pytest.warns(DeprecationWarning, match=f"{old} is deprecated: use {new}"):
        assert find(old) is find(new)


@pytest.mark.parametrize("module", sorted({name.rpartition(".")[0] for name in MOVED}))
def test_unknown_attributes_of_modules_are_errors(module):
    with pytest.raises(AttributeError, match="no_such_name"):
        find(f"{module}.no_such_name")


def test_renamed_contact_code_warns_and_resolves():
    with pytest.warns(DeprecationWarning, match=r"Contact.RUN_INTO is deprecated"):
        assert Contact.RUN_INTO is Contact.HIT_BY_PEDESTRIAN
    assert "RUN_INTO" not in Contact.__members__
    with pytest.raises(AttributeError, match="NO_SUCH_CODE"):
        _ = Contact.NO_SUCH_CODE


def test_renamed_contact_code_is_found_by_name():
    with pytest.warns(DeprecationWarning, match=r"RUN_INTO is deprecated: use Contact.HIT_BY_PED"):
        assert Contact["RUN_INTO"] is Contact.HIT_BY_PEDESTRIAN
    assert Contact["STATIC"] is Contact.STATIC
    with pytest.raises(KeyError, match="NO_SUCH_CODE"):
        _ = Contact["NO_SUCH_CODE"]


def test_action_size_of_the_exploration_warns():
    with pytest.warns(DeprecationWarning, match="action_size is deprecated"):
        assert GaussianExploration(std=[1.0, 0.5]).action_size == 2


def test_renamed_setting_of_the_oracle_warns():
    with pytest.warns(DeprecationWarning, match="greed is deprecated: use heuristic_weight"):
        effort = SearchEffort(margin=0.1, greed=2.0, max_nodes=10)
    with pytest.warns(DeprecationWarning, match="greed is deprecated: use heuristic_weight"):
        assert effort.greed == effort.heuristic_weight == 2.0


def test_renamed_methods_warn_and_call_the_new_ones():
    class Recorded:
        def q_value(self, action, feature):
            return action + feature

        def skip(self, worlds):
            self.skipped = worlds

    recorded = Recorded()
    with pytest.warns(DeprecationWarning, match="judge is deprecated: use q_value"):
        assert CriticNetwork.judge(recorded, 1, 2) == 3
    with pytest.warns(DeprecationWarning, match="rest is deprecated: use skip"):
        Simulator.rest(recorded, torch.tensor([True]))
    assert recorded.skipped.tolist() == [True]


@pytest.mark.parametrize("old, new", [("least_speed", "min"), ("most_speed", "max")])
def test_renamed_config_keys_of_dwa_warn(old, new):
    cfg = compose("evaluate", ["policy=dwa_predictive", f"+change.controller.{old}=0.5"])
    with pytest.warns(FutureWarning, match=f"{old} is deprecated: use {new}_descriptor_speed"):
        node = with_controller(cfg).controller
    assert 0.5 in instantiate(node).speed_range
    with pytest.warns(DeprecationWarning, match=f"{old} is deprecated: use {new}_descriptor_speed"):
        assert 0.5 in DynamicWindow(DifferentialDrive(), **{old: 0.5}).speed_range


GROUP_WARNS = "config group behaviour is deprecated: use behavior"


@pytest.mark.parametrize(
    "old", ["behaviour=paper", "behaviour.guided_frames=1", "++behaviour.random_frames=0"]
)
def test_former_group_warns_and_has_its_effect(old):
    with pytest.warns(FutureWarning, match=GROUP_WARNS):
        composed = compose("train", [old])
    assert composed == compose("train", [old.replace("behaviour", "behavior")])
    assert composed != compose("train")


@pytest.mark.parametrize("word", ["behaviour", "behaviours=1", "policy=behaviour", "--behaviour=1"])
def test_other_words_of_a_command_are_unchanged(word):
    assert renamed_overrides([word]) == [word]


@pytest.mark.parametrize("prefix, rest", [("~", ""), ("+", "@x=paper"), ("~", "=paper")])
def test_former_group_is_renamed_in_each_kind_of_override(prefix, rest):
    with pytest.warns(FutureWarning, match=GROUP_WARNS):
        words = renamed_overrides([f"{prefix}behaviour{rest}"])
    assert words == [f"{prefix}behavior{rest}"]


def run(command, words, monkeypatch, capsys):
    """Run a command with these words; return its exit status and its last line."""
    monkeypatch.setattr(sys, "argv", [f"navrl-{command}", *words])
    status = 0
    try:
        import_module(f"navrl.cli.{command}").main()
    except SystemExit as end:
        status = end.code
    shown = capsys.readouterr()
    return status, (shown.out + shown.err).splitlines()[-1]


def test_command_accepts_the_former_group(monkeypatch, capsys):
    words = ["behaviour=paper", "behaviour.random_frames=7", "--cfg", "job", "--package"]
    with pytest.warns(FutureWarning, match=GROUP_WARNS):
        status, line = run("train", [*words, "behavior"], monkeypatch, capsys)
    assert status == 0 and line == "random_frames: 7"


@pytest.mark.parametrize(
    "text, message",
    [
        ("defaults: [override /behaviour: paper]", "write 'override /behavior' in this file"),
        ("behaviour: {guided_frames: 1}", "navrl: behaviour: must be behavior, the present name"),
    ],
)
def test_experiment_with_the_former_group_is_an_error(tmp_path, monkeypatch, capsys, text, message):
    (tmp_path / "experiment").mkdir()
    (tmp_path / "experiment" / "mine.yaml").write_text(f"# @package _global_\n{text}\n")
    options = ["--config-dir", str(tmp_path), "experiment=mine"]
    words = [*options, f"hydra.run.dir={tmp_path}/run"]
    status, line = run("train", words, monkeypatch, capsys)
    assert status == 2 and message in line


def test_own_option_in_the_former_folder_is_an_error(tmp_path, monkeypatch, capsys):
    (tmp_path / "behaviour").mkdir()
    (tmp_path / "behaviour" / "mine.yaml").write_text("guide: null\n")
    options = ["--config-dir", str(tmp_path), "behavior=mine"]
    words = [*options, f"hydra.run.dir={tmp_path}/run"]
    status, line = run("train", words, monkeypatch, capsys)
    assert status == 2 and "options of behaviour/ belong in behavior/ now" in line


def test_run_of_the_former_group_is_resumed(tmp_path):
    text = OmegaConf.to_yaml(compose("train"))
    former = text.replace("behavior", "behaviour").replace("Behavior", "Behaviour")
    assert former.count("ehaviour") == 2
    (tmp_path / "checkpoint").mkdir()
    for name in ("config.yaml", "checkpoint/config.yaml"):
        (tmp_path / name).write_text(former)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        resumed = resumed_config(tmp_path, compose("train"), [])
        claim_folder(compose("train"), tmp_path)  # as the restarted job of a sweep does
    assert OmegaConf.to_yaml(resumed) == text


def test_collector_with_the_former_argument_is_built():
    class Alternating(DirectCollector):
        def __init__(self, make_env, behaviour, seed):
            self.given = behaviour

    assert taken_argument(DirectCollector, "behavior") == "behavior"
    with pytest.warns(DeprecationWarning, match="Alternating: behaviour is deprecated"):
        assert taken_argument(Alternating, "behavior") == "behaviour"
    cfg = compose("train", ["network=small"])
    cfg.collector._target_ = "former.Collector"
    with (
        mock.patch.dict(sys.modules, {"former": SimpleNamespace(Collector=Alternating)}),
        pytest.warns(DeprecationWarning, match="call it behavior"),
    ):
        assert isinstance(make_collector(cfg, actor=torch.nn.Identity()).given, Behavior)
    with pytest.warns(DeprecationWarning, match="behaviour is deprecated: use behavior"):
        assert DirectCollector(lambda seed: seed, behaviour=1, seed=0).behavior == 1


@pytest.mark.parametrize(
    "key",
    mostly(["least_speed", "most_speed", "efforts.0.greed", "clearance"], ["least_speed"]),
)
def test_override_of_a_controller_names_the_change(key, monkeypatch, capsys):
    present = key.replace("least_", "min_descriptor_").replace("most_", "max_descriptor_")
    change = f"+change.controller.{present.replace('greed', 'heuristic_weight')}="
    for prefix in ("", "+"):
        words = [f"{prefix}controller.{key}=2", "policy=dwa", "hydra.run.dir=."]
        status, line = run("evaluate", words, monkeypatch, capsys)
        assert status == 2 and f"; {change}" in line and "use +controller" not in line


@pytest.mark.parametrize("group", ["transforms", "deployment.transforms"])
def test_former_key_of_a_transform_is_renamed(group):
    with pytest.warns(FutureWarning, match="least_speed is deprecated: use min_descriptor_speed"):
        words = renamed_overrides([f"{group}.action_shield.least_speed=0.5"])
    assert words == [f"{group}.action_shield.min_descriptor_speed=0.5"]


@pytest.mark.parametrize("name", zoo_names())
def test_actor_names_the_present_key_of_a_former_input(name):
    bundle = load_bundle(ZOO / name)
    actor, shapes = bundle.actor, bundle.config["actor"]["shapes"]
    former, present = next(names for names in RENAMED_INPUTS.items() if names[1] in actor.in_keys)
    observed = TensorDict({key: torch.zeros(1, *shapes[key]) for key in actor.in_keys}, [1])
    observed = observed.rename_key_(present, former)
    with pytest.raises(KeyError, match=f"{present}: missing; {former} is its name of version"):
        actor(observed)
    with pytest.raises(KeyError, match=present) as error:
        actor(observed.exclude(former))
    assert "its name of version" not in str(error.value)


def test_critic_names_the_present_key_of_a_former_input():
    shapes = {"goal_position_scaled": [2]}
    goal = partial(VectorStream, in_key="goal_position_scaled", hidden=[4])
    critic = make_critic(partial(StreamEncoder, streams={"goal": goal}), shapes)
    observed = TensorDict({"action": torch.zeros(1, 2), "goal": torch.zeros(1, 2)}, [1])
    with pytest.raises(KeyError, match="goal_position_scaled: missing; goal is its name"):
        critic(observed)
    values = {"action": torch.zeros(1, 2), "goal_position_scaled": torch.zeros(1, 2)}
    assert critic(**values).shape == (1, 1)  # by keyword, as before


@pytest.mark.parametrize("names", [["hit_by_pedestrian", "run_into"], ["spl", "spl"]])
def test_metric_listed_twice_is_an_error(tmp_path, names):
    write_evaluation(tmp_path / "a", "paper", [WON, HIT])
    (table,) = compare(find_evaluations([tmp_path]))
    with pytest.raises(ValueError, match=rf"^metrics=\['{names[0]}'\]: must be listed once"):
        metrics_markdown(table, names)


@pytest.mark.parametrize("name", zoo_names())
def test_shipped_bundles_load_without_deprecation_warnings(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        warnings.simplefilter("error", FutureWarning)
        load_bundle(ZOO / name)


def test_renamed_key_changes_a_shipped_bundle_of_version_0_1():
    change = "+change.transforms.action_shield.least_speed=0.5"
    with pytest.warns(FutureWarning, match="config key least_speed is deprecated"):
        old = make_runner(compose("evaluate", ["policy=navrl-best", change]))
    new = change.replace("least", "min_descriptor")
    new = make_runner(compose("evaluate", ["policy=navrl-best", new]))
    for runner in (old, new):
        (shield,) = (part for part in runner.transform.modules() if isinstance(part, ActionShield))
        assert shield.speed_range == (0.5, 1.5)


def test_renamed_argument_must_be_given_once():
    @renamed_arguments(least="smallest")
    def function(smallest):
        return smallest

    assert function(1) == function(smallest=1) == 1
    with pytest.warns(DeprecationWarning, match="least is deprecated: use smallest"):
        assert function(least=2) == 2
    with pytest.raises(TypeError, match="must be given once, as smallest"):
        function(smallest=1, least=2)


@pytest.mark.parametrize("observed", ["waypoints_scaled", "waypoint"])
def test_networks_read_inputs_under_names_of_version_0_1(observed):
    shapes = {"spatial": [180, 2], observed: [5, 2]}
    assert AttentionStream("spatial", shapes).in_keys == ["spatial", observed]
    if observed == "waypoint":
        assert VectorStream("waypoint", shapes, [8]).in_keys == ["waypoint"]
        return
    with pytest.warns(DeprecationWarning, match="input key waypoint is deprecated: use waypoints_"):
        assert VectorStream("waypoint", shapes, [8]).in_keys == ["waypoints_scaled"]


@pytest.mark.parametrize("name", zoo_names())
def test_shipped_bundles_have_present_names_of_inputs(name):
    bundle = load_bundle(ZOO / name)
    assert not set(bundle.actor.in_keys) & RENAMED_INPUTS.keys()
    text = str(bundle.config)
    assert all(f"'{key}'" not in text for key in ("waypoint", "distance", "distances"))


def test_renamed_input_of_a_model_of_another_library_is_found():
    key = input_key("waypoint", ["ranges", "waypoints_scaled"])
    assert key == "waypoints_scaled"
    assert input_key("no_such_key", ["ranges"]) == "no_such_key"
