"""A bundle runs what was saved, and nothing that a stranger slipped in."""

import copy
import shutil
import sys

import pytest
import torch
import yaml
from safetensors.torch import load_file, save_file
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.envs import Transform

from navrl import keys
from navrl.policies import BundleError, load_bundle, save_bundle
from navrl.policies.nodes import build_node
from navrl.sim import DifferentialDrive, Lidar

STREAM = {
    "_target_": "navrl.networks.AttentionStream",
    "_partial_": True,
    "num_items": 6,
    "embedding": [8, 4],
    "score": [4, 1],
    "feature": [5],
}
CONFIG = {
    "transforms": {
        "_target_": "navrl.transforms.compose",
        "min_pool": {"_target_": "navrl.transforms.MinPool", "group_size": 8, "max_range": 3.5},
    },
    "lidar": {"_target_": "navrl.sim.Lidar", "num_beams": 96, "mount": [0.0, 0.1, 0.0]},
    "robot": {"_target_": "navrl.sim.DifferentialDrive", "max_speed": 0.7},
    "actor": {
        "_target_": "navrl.networks.make_actor",
        "encoder": {
            "_target_": "navrl.networks.StreamEncoder",
            "_partial_": True,
            "streams": {
                "spatial": {**STREAM, "in_key": "spatial"},
                "temporal": {**STREAM, "in_key": "temporal"},
            },
        },
        "shapes": {"spatial": [12, 2], "temporal": [6, 4], "waypoints_scaled": [5, 2]},
        "hidden": [8],
    },
    "time_step_s": 0.2,
}


def observation(batch=7):
    generator = torch.Generator().manual_seed(0)
    shapes = CONFIG["actor"]["shapes"].items()
    values = {k: torch.rand(batch, *shape, generator=generator) for k, shape in shapes}
    return TensorDict(values, [batch])


@pytest.fixture(scope="module")
def actor():
    torch.manual_seed(0)
    return build_node(CONFIG["actor"], (), "actor")


@pytest.fixture
def folder(tmp_path, actor):
    folder = tmp_path / "policy"
    save_bundle(folder, config=CONFIG, actor=actor, metrics={"success_rate": 0.5}, card="# Card\n")
    return folder


def edited(folder, edit):
    """The bundle after ``edit`` has changed its config."""
    file = folder / "config.yaml"
    config = yaml.safe_load(file.read_text())
    edit(config)
    file.write_text(yaml.safe_dump(config))
    return folder


# --- round trip ----------------------------------------------------------------------------------


def test_loaded_actor_equals_the_saved_one(folder, actor):
    torch.manual_seed(1)  # weights come from the file, not from luck
    bundle = load_bundle(folder)
    expected = actor(observation())[keys.ACTION]
    assert torch.equal(bundle.actor(observation())[keys.ACTION], expected)
    assert not bundle.actor.training
    assert bundle.metrics == {"success_rate": 0.5}
    assert bundle.config["time_step_s"] == 0.2
    assert (folder / "card.md").read_text() == "# Card\n"


def test_bundle_builds_its_parts(folder):
    bundle = load_bundle(folder)
    assert isinstance(bundle.build("transforms"), Transform)
    lidar, robot = bundle.build("lidar"), bundle.build("robot", max_speed=0.4)
    assert isinstance(lidar, Lidar)
    assert isinstance(robot, DifferentialDrive)
    assert (lidar.num_beams, robot.max_speed) == (96, 0.4)
    assert bundle.build("robot").max_speed == 0.7


def test_requested_attention_changes_no_action(folder):
    bundle = load_bundle(folder)
    plain, shown = bundle.actor(observation()), bundle.actor_with_attention()(observation())
    assert not bundle.actor_with_attention().training
    assert keys.SPATIAL_ATTENTION not in plain
    assert torch.equal(plain[keys.ACTION], shown[keys.ACTION])
    torch.testing.assert_close(shown[keys.SPATIAL_ATTENTION].sum(-1), torch.ones(7))


def test_equal_bundles_have_equal_bytes(tmp_path, actor):
    for name in ("a", "b"):
        save_bundle(tmp_path / name, config=CONFIG, actor=actor, metrics={"x": 1}, card="c")
    names = {file.name for file in (tmp_path / "a").iterdir()}
    assert names == {"config.yaml", "weights.safetensors", "metrics.json", "card.md"}
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_save_replaces_a_bundle_completely(folder, actor):
    save_bundle(folder, config=CONFIG, actor=actor, metrics={"success_rate": 0.9}, card="")
    assert load_bundle(folder).metrics == {"success_rate": 0.9}
    assert [path.name for path in folder.parent.iterdir()] == ["policy"]


def test_failed_save_preserves_the_old_bundle(folder, actor):
    parts = {name: node for name, node in CONFIG.items() if name != "robot"}
    for config, message in ((parts, "robot"), ({**CONFIG, "x": object()}, "plain data")):
        with pytest.raises(ValueError, match=message):
            save_bundle(folder, config=config, actor=actor, metrics={}, card="")
    with pytest.raises(TypeError):
        save_bundle(folder, config=CONFIG, actor=actor, metrics={"x": object()}, card="")
    assert load_bundle(folder).metrics == {"success_rate": 0.5}


def test_repeated_config_nodes_are_written_without_aliases(tmp_path, actor):
    """As an alias it could not be loaded again."""
    shared = [8, 4]
    config = copy.deepcopy(CONFIG)
    for stream in config["actor"]["encoder"]["streams"].values():
        stream["embedding"] = shared
    save_bundle(tmp_path / "p", config=config, actor=actor, metrics={}, card="")
    assert load_bundle(tmp_path / "p").config["actor"] == config["actor"]


# --- damage --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["config.yaml", "weights.safetensors", "metrics.json"])
def test_missing_files_are_named(folder, name):
    (folder / name).unlink()
    with pytest.raises(BundleError, match=rf"{name}: no such file"):
        load_bundle(folder)


@pytest.mark.parametrize("name", ["config.yaml", "weights.safetensors", "metrics.json"])
@pytest.mark.parametrize("keep", [0.0, 0.5, 0.99])
def test_truncated_files_are_named(folder, name, keep):
    content = (folder / name).read_bytes().rstrip()
    (folder / name).write_bytes(content[: int(keep * len(content))])
    with pytest.raises(BundleError) as error:
        load_bundle(folder)
    assert name in str(error.value) or "actor" in str(error.value)


@pytest.mark.parametrize(
    "text, message",
    [
        ("format: navrl-policy-999\n", "navrl-policy-999"),
        ("format: navrl-policy-1\n", r"missing \['transforms', 'actor', 'lidar', 'robot'\]"),
        ("- a list\n", "list"),
        ("a: [1, 2\n", r"config\.yaml"),
        ("a: &a [*a]\n", "aliases"),
        ("a: &a [1]\nb: *a\n", "aliases"),
        ("[" * 20000, r"config\.yaml"),
        ("a: !!python/object/apply:os.system ['true']\n", "python/object"),
        ("\udcff\udcfe", r"config\.yaml"),
    ],
)
def test_bad_configs_are_explained(folder, text, message):
    (folder / "config.yaml").write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(BundleError, match=message):
        load_bundle(folder)


def test_weights_of_another_network_are_rejected(folder):
    file = folder / "weights.safetensors"
    weights = load_file(file)
    save_file({name: value[..., :1].contiguous() for name, value in weights.items()}, file)
    with pytest.raises(BundleError, match=r"weights\.safetensors.*size mismatch.*more\)$") as error:
        load_bundle(folder)
    assert "\n" not in str(error.value)


def test_weights_without_a_layer_are_rejected(folder):
    file = folder / "weights.safetensors"
    weights = load_file(file)
    weights.pop("module.output.2.bias")
    save_file(weights, file)
    with pytest.raises(BundleError, match=r'Missing key.*"module\.output\.2\.bias"'):
        load_bundle(folder)


def test_pickled_weights_are_not_read(folder, actor):
    torch.save(actor.state_dict(), folder / "weights.safetensors")
    with pytest.raises(BundleError, match=r"weights\.safetensors"):
        load_bundle(folder)


@pytest.mark.parametrize(
    "part, node, message",
    [
        ("actor", {"_target_": "navrl.sim.Lidar"}, "TensorDictModule"),
        ("actor", {"_target_": "navrl.networks.make_actor", "unknown": 1}, "unknown"),
        ("actor", {**CONFIG["actor"], "hidden": [10**14]}, "actor"),
        ("metrics", None, "must contain an object"),
    ],
)
def test_invalid_actor_is_explained(folder, part, node, message):
    if part == "metrics":
        (folder / "metrics.json").write_text("[1]")
    else:
        edited(folder, lambda config: config.update({part: node}))
    with pytest.raises(BundleError, match=message):
        load_bundle(folder)


# --- weights and robot limits --------------------------------------------------------------------


def stored(folder, change):
    """The bundle after ``change`` has replaced the weights of one layer."""
    file = folder / "weights.safetensors"
    weights = load_file(file)
    name = "module.output.0.weight"
    weights[name] = change(weights[name].clone())
    save_file(weights, file)
    return folder


def poked(value, dtype=torch.float32):
    def change(weight):
        weight = weight.to(dtype)
        weight[1, 0] = value
        return weight

    return change


@pytest.mark.parametrize(
    "change, message",
    [
        (poked(float("nan")), r"module\.output\.0\.weight: value=nan: must be finite"),
        (poked(float("-inf")), "value=-inf: must be finite"),
        (poked(1e300, torch.float64), "value=inf: must be finite"),
        (lambda weight: weight.to(torch.int8), r"dtype=torch\.int8: must be floating point"),
        (lambda weight: weight > 0, r"dtype=torch\.bool: must be floating point"),
        (lambda weight: weight.to(torch.complex64), "must be floating point"),
    ],
)
def test_non_finite_or_integer_weights_are_rejected(folder, change, message):
    with pytest.raises(BundleError, match=rf"weights\.safetensors: .*{message}"):
        load_bundle(stored(folder, change))


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float64])
def test_weights_in_another_precision_are_loaded(folder, dtype):
    bundle = load_bundle(stored(folder, lambda weight: weight.to(dtype)))
    assert bundle.actor.get_parameter("module.output.0.weight").dtype == torch.float32


def test_unexpected_weights_are_rejected(folder):
    file = folder / "weights.safetensors"
    save_file({**load_file(file), "extra": torch.zeros(1, dtype=torch.int8)}, file)
    with pytest.raises(BundleError, match=r'Unexpected key.*"extra"'):
        load_bundle(folder)


def test_bundle_files_are_readable_by_all_users(folder):
    assert all(file.stat().st_mode & 0o444 == 0o444 for file in folder.iterdir())


def test_non_finite_weights_are_not_saved(folder, actor):
    broken = copy.deepcopy(actor)
    broken.get_parameter("module.output.0.weight").data[0, 0] = float("nan")
    with pytest.raises(ValueError, match=r"module\.output\.0\.weight: value=nan: must be finite"):
        save_bundle(folder, config=CONFIG, actor=broken, metrics={}, card="")
    assert load_bundle(folder).metrics == {"success_rate": 0.5}


@pytest.mark.parametrize(
    "values, message",
    [
        ({"max_speed": 1e9}, r"robot\.max_speed=1e\+09: must be at most 10 m/s"),
        ({"max_speed": 10.1}, r"robot\.max_speed=10\.1: must be at most"),
        ({"min_speed": -11.0}, r"robot\.min_speed=-11: must be at most"),
        ({"max_turn_rate": 26.0}, r"robot\.max_turn_rate=26: must be at most 25\.13 rad/s"),
        ({"max_speed": float("nan")}, "robot: .*max_speed"),
        ({"max_speed": "fast"}, "robot: "),
    ],
)
def test_implausible_robot_limits_are_rejected(folder, values, message):
    with pytest.raises(BundleError, match=message):
        load_bundle(edited(folder, lambda config: config["robot"].update(values)))


def test_limits_of_a_fast_robot_are_accepted(folder):
    fast = {"min_speed": -10.0, "max_speed": 10.0, "max_turn_rate": 25.0}
    bundle = load_bundle(edited(folder, lambda config: config["robot"].update(fast)))
    assert bundle.build("robot").max_speed == 10.0


@pytest.mark.parametrize(
    "part, node, message",
    [
        ("transforms", {"_target_": "navrl.sim.Lidar"}, "transforms: must be a Transform"),
        ("transforms", {"_target_": "navrl.transforms.MinPool", "group_size": 0}, "group_size"),
        ("lidar", {"_target_": "navrl.sim.Lidar", "max_range": -1.0}, "max_range"),
        ("lidar", {"_target_": "navrl.sim.DifferentialDrive"}, "lidar: must be a Lidar"),
        ("robot", {"_target_": "navrl.sim.Lidar"}, "robot: must be a RobotModel"),
    ],
)
def test_every_part_is_built_at_load(folder, part, node, message):
    with pytest.raises(BundleError, match=message):
        load_bundle(edited(folder, lambda config: config.update({part: node})))


# --- strangers -----------------------------------------------------------------------------------

HOSTILE = [
    "os.system",
    "builtins.eval",
    "subprocess.run",
    "torch.load",
    "torch.hub.load",
    "functools.partial",
    "hydra.utils.instantiate",
    "navrl",
    "navrl.",
    "navrl..networks.make_actor",
    ".navrl.networks.make_actor",
    "navrl_evil.networks.make_actor",
    "navrl.networksevil.make_actor",
    "navrl.networks",
    "navrl.networks.nothing",
    "navrl.networks.actor_critic.torch.load",
    "navrl.networks.actor_critic.Callable",
    "navrl.networks.actor_critic.nn.Sequential",
    "navrl.networks.attention.torch",
    "navrl.sim.import_module",
    "navrl.sim.__getattr__",
    "navrl.transforms.pipeline.Compose",
    "navrl.policies.bundle.os.system",
    "navrl.policies.bundle.shutil.rmtree",
    "navrl.policies.load_bundle",  # would load another bundle with everything allowed
    "navrl.policies.save_bundle",
    "navrl.policies.nodes.build_node",
    "navrl.config.instantiate",
    "navrl.factory.make_gymnasium_env",  # its overrides can hold any target
    "navrl.worlds.Scenario.load",
    "navrl.networks.make_actor.__globals__",
    5,
    None,
    ["navrl.networks.make_actor"],
    {"_target_": "navrl.networks.make_actor"},
]


@pytest.mark.parametrize("target", HOSTILE, ids=str)
@pytest.mark.parametrize("partial", [False, True], ids=["called", "partial"])
def test_untrusted_target_is_not_built(folder, target, partial):
    node = {"_target_": target, "_partial_": True} if partial else {"_target_": target}
    before = set(sys.modules)
    with pytest.raises(BundleError, match="_target_"):
        load_bundle(edited(folder, lambda config: config.update(actor=node)))
    assert not {m for m in set(sys.modules) - before if not m.startswith("navrl.")}


def in_streams(config, node):
    config["actor"]["encoder"]["streams"]["spatial"]["embedding"] = [8, [1, {"deep": [node]}]]


@pytest.mark.parametrize(
    "hide",
    [
        in_streams,
        lambda config, node: config["actor"].update(hidden=node),
        lambda config, node: config["transforms"].update(last=node),
        lambda config, node: config["lidar"].update(mount=[0.0, 0.0, node]),
        lambda config, node: config["robot"].update(max_speed={"_partial_": True, **node}),
    ],
)
def test_nothing_is_built_before_everything_is_checked(tmp_path, folder, hide):
    mark = tmp_path / "ran"
    node = {"_target_": "pathlib.Path.touch", "self": str(mark)}
    with pytest.raises(BundleError, match=r"pathlib\.Path\.touch"):
        load_bundle(edited(folder, lambda config: hide(config, node)))
    node = {"_target_": "shutil.copyfile", "src": str(folder / "card.md"), "dst": str(mark)}
    with pytest.raises(BundleError, match=r"shutil\.copyfile"):
        load_bundle(edited(folder, lambda config: hide(config, node)))
    assert not mark.exists()


def test_nested_bundle_has_no_additional_rights(tmp_path, folder):
    mark, inner = tmp_path / "ran", tmp_path / "inner"
    shutil.copytree(folder, inner)
    copying = {"_target_": "shutil.copyfile", "src": str(folder / "card.md"), "dst": str(mark)}
    edited(inner, lambda config: config.update(actor=copying))
    chain = {
        "_target_": "navrl.policies.bundle.load_bundle",
        "folder": str(inner),
        "allow": ["shutil"],
    }
    with pytest.raises(BundleError, match="load_bundle"):
        load_bundle(edited(folder, lambda config: config.update(actor=chain)))
    assert not mark.exists()


@pytest.mark.parametrize(
    "value", ["${oc.env:HOME}", "${oc.create:{_target_:os.system,command:ls}}", "a ${b} c"]
)
@pytest.mark.parametrize("part", ["transforms", "actor", "lidar", "robot"])
def test_interpolations_are_rejected(folder, part, value):
    """The evaluator merges a bundle's nodes into its own config, where they would be resolved."""
    with pytest.raises(BundleError, match=rf"{part}\.evil.*interpolation"):
        load_bundle(edited(folder, lambda config: config[part].update(evil=value)))


# --- what the caller allows ----------------------------------------------------------------------

USERS = """
from navrl.networks import make_actor

class Doubled:
    def __new__(cls, **kwargs):
        return make_actor(**kwargs)
"""


@pytest.fixture
def users_package(tmp_path, monkeypatch):
    for name in ("users_package", "users_package_2"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(USERS)
    monkeypatch.syspath_prepend(tmp_path)
    yield "users_package"
    for name in ("users_package", "users_package_2"):
        sys.modules.pop(name, None)


def test_a_users_target_is_built_if_allowed(folder, users_package):
    edited(folder, lambda config: config["actor"].update(_target_=f"{users_package}.Doubled"))
    with pytest.raises(BundleError, match=r"users_package\.Doubled.*allow"):
        load_bundle(folder)
    assert users_package not in sys.modules
    bundle = load_bundle(folder, allow=[users_package])
    assert isinstance(bundle.actor, TensorDictModule)
    assert keys.SPATIAL_ATTENTION in bundle.actor_with_attention().out_keys
    with pytest.raises(ValueError, match="list"):
        load_bundle(folder, allow=users_package)


def test_allowed_package_allows_no_other_package(folder, users_package):
    for target in ("os.system", "users_package_2.Doubled", "navrl.policies.load_bundle"):
        edited(folder, lambda config, t=target: config["actor"].update(_target_=t))
        with pytest.raises(BundleError, match=target):
            load_bundle(folder, allow=[users_package])
