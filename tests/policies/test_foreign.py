"""References to policies from outside navrl, and what such a policy is passed."""

import sys
import textwrap

import pytest
import torch
from tensordict import TensorDict

from navrl.config import compose
from navrl.factory import make_evaluated_policy
from navrl.factory.policy_names import check_policy_name
from navrl.policies import BundleError, Controller, StableBaselines3Policy, load_policy
from navrl.policies.foreign import foreign_name, foreign_node
from navrl.policies.nodes import build_node
from navrl.policies.sight import RestrictedPolicy
from navrl.sim import DifferentialDrive

ROBOT = DifferentialDrive()


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Write the user's own module ``own_policies``."""
    text = """
        import torch
        from navrl.policies import Controller

        def ahead(tensordict):
            return tensordict.set("action", torch.zeros(*tensordict.batch_size, 2))

        class Turning(Controller):
            def __init__(self, robot, rate):
                super().__init__()
                self.in_keys, self.rate, self.robot = ["ranges"], rate, robot
            def forward(self, tensordict):
                return tensordict.set("action", torch.full((*tensordict.batch_size, 2), self.rate))

        number = 3

        class Mute:
            pass
    """
    (tmp_path / "own_policies.py").write_text(textwrap.dedent(text))
    monkeypatch.syspath_prepend(str(tmp_path))
    yield "own_policies"
    sys.modules.pop("own_policies", None)


@pytest.mark.parametrize(
    "policy, name",
    [
        ("my_package.cautious:Cautious", "Cautious"),
        ("models/ppo.onnx", "ppo"),
        ("a/td3.zip", "td3"),
        ("process:python3 -u tools/follow.py --gain 0.5", "follow"),
        ("process:./follow", "follow"),
        ("tcp://localhost:5555", "localhost:5555"),
        ("outputs/train/mine", "outputs/train/mine"),
    ],
)
def test_references_have_short_names(policy, name):
    assert foreign_name(policy) == name


@pytest.mark.parametrize("policy", ["paper", "outputs/train/mine", "C:/policy", "my.package", ":x"])
def test_other_names_are_no_references(policy):
    assert foreign_node(policy) is None


@pytest.mark.parametrize(
    "policy, message",
    [
        ("no_such.onnx", "policy=no_such.onnx: must be a file that exists"),
        ("no_such.zip", "policy=no_such.zip: must be a file that exists"),
        ("process:", "policy=process:: must be followed by a command"),
        ("process:a 'b", "policy=process:a 'b: No closing quotation"),
        ("papre", "policy=papre: no such bundle .*MODULE:NAME, process:COMMAND or tcp://"),
    ],
)
def test_wrong_references_are_named(policy, message):
    with pytest.raises(ValueError, match=message):
        check_policy_name(policy)


def test_functions_and_classes_are_loaded(module):
    acted = load_policy(f"{module}:ahead", ROBOT)(TensorDict({}, [3]))
    assert acted["action"].tolist() == [[0.0, 0.0]] * 3
    turning = load_policy(f"{module}:Turning", ROBOT, rate=0.5)
    assert turning.robot is ROBOT
    assert turning(TensorDict({}, [1]))["action"].tolist() == [[0.5, 0.5]]


@pytest.mark.parametrize(
    "name, arguments, message",
    [
        ("absent", {}, "policy=own_policies:absent: .*absent.*PYTHONPATH=. finds"),
        ("number", {}, "policy=own_policies:number: must be a class or function, got 3"),
        ("ahead", {"rate": 1}, "policy=own_policies:ahead: a function has no arguments"),
        ("Turning", {}, r"'rate'; \+change.controller.NAME=VALUE sets rate"),
        ("Mute", {}, "policy=own_policies:Mute: its objects must be callable"),
    ],
)
def test_wrong_callables_are_named(module, name, arguments, message):
    with pytest.raises(ValueError, match=message):
        load_policy(f"{module}:{name}", ROBOT, **arguments)


def test_missing_module_is_named():
    with pytest.raises(ValueError, match="policy=no_module:f: No module named 'no_module'"):
        load_policy("no_module:f", ROBOT)


def test_untrusted_zip_is_rejected(tmp_path):
    file = tmp_path / "ppo.zip"
    file.write_bytes(b"PK")
    with pytest.raises(ValueError, match=r"ppo.zip: loading it runs code .* set trusted=true"):
        StableBaselines3Policy(file)
    node = compose("evaluate", [f"policy={file}"])
    with pytest.raises(Exception, match="loading it runs code"):
        make_evaluated_policy(node)


@pytest.mark.parametrize("name", ["RemotePolicy", "load_policy", "OnnxPolicy"])
def test_bundles_may_not_name_policies(name):
    with pytest.raises(BundleError, match=r"must be exported by navrl.transforms"):
        build_node({"_target_": f"navrl.policies.{name}"}, (), "actor")


# --- what a policy is passed ---------------------------------------------------------------------


class Seeing(Controller):
    def __init__(self, in_keys=None, privileged=False):
        super().__init__()
        self.privileged, self.seen = privileged, None
        if in_keys is not None:
            self.in_keys = in_keys

    def forward(self, tensordict):
        self.seen = set(tensordict.keys())
        tensordict["ranges"] = torch.zeros(1, 4)
        tensordict["memory"] = torch.ones(1, 1)
        return tensordict.set("action", torch.zeros(1, 2))


class Undeclared:
    def __init__(self):
        self.seen = None

    def __call__(self, tensordict):
        self.seen = set(tensordict.keys())
        return tensordict.set("action", torch.zeros(1, 2))


def observation():
    values = {"ranges": torch.ones(1, 4), "pose": torch.ones(1, 3), "action": torch.ones(1, 2)}
    return TensorDict({**values, "pedestrian_boxes": torch.ones(1, 2, 5)}, [1])


def test_policy_is_passed_its_declared_keys():
    policy = Seeing(["ranges", "memory"])
    acted = RestrictedPolicy(policy)(observation())
    assert policy.seen == {"ranges", "action"}
    assert acted["ranges"].tolist() == [[1.0] * 4]  # the observation is not changed
    assert acted["action"].tolist() == [[0.0, 0.0]] and "pedestrian_boxes" in acted
    RestrictedPolicy(policy)(acted)
    assert policy.seen == {"ranges", "memory", "action"}  # a key of its own is carried


class Counting:
    in_keys = ("memory",)

    def __call__(self, tensordict):
        memory = tensordict.get("memory", torch.zeros(1, 1)) + 1
        return TensorDict({"memory": memory, "pose": 0 * memory, "action": memory}, [1])


def test_policy_replaces_its_own_entries_only():
    policy, step = RestrictedPolicy(Counting()), observation()
    for number in range(1, 4):
        step = policy(step)
        assert step["memory"].item() == number
    assert step["pose"].tolist() == [[1.0] * 3]


def test_true_state_is_withheld_from_policies_without_keys():
    policy = Undeclared()
    RestrictedPolicy(policy)(observation())
    assert policy.seen == {"ranges", "pose", "action"}


def test_privileged_policy_is_passed_everything():
    policy = Seeing([], privileged=True)
    RestrictedPolicy(policy)(observation())
    assert policy.seen == set(observation().keys())


@pytest.mark.parametrize("key", ["pedestrian_boxes", "contact", ("reward_terms", "collision")])
def test_true_state_is_for_privileged_policies_only(key):
    with pytest.raises(ValueError, match=r"in_keys has .* only a class with privileged = True"):
        RestrictedPolicy(Seeing([key]))
    RestrictedPolicy(Seeing([key], privileged=True))


class Reading:
    in_keys = ("rnages",)

    def __call__(self, tensordict):
        return tensordict.set("action", tensordict["rnages"][:, :2])


@pytest.mark.parametrize("policy", [Reading(), Seeing(["ranges", "rnages"])])
def test_misspelt_key_of_a_policy_is_named(policy):
    message = "in_keys has 'rnages': must be observed, .*; observed: action, pose, ranges$"
    with pytest.raises(ValueError, match=message):
        RestrictedPolicy(policy)(observation())


@pytest.mark.parametrize(
    "action, message",
    [
        (torch.zeros(2), r"action has shape \[2\]: must be \[1, C\]"),
        (torch.tensor([[0.5, torch.nan]]), "action=nan: must be finite"),
        (torch.tensor([[torch.inf, 0.0]]), "action=inf: must be finite"),
    ],
)
def test_unusable_action_is_named(action, message):
    with pytest.raises(ValueError, match=message):
        RestrictedPolicy(lambda _: TensorDict({"action": action}, []))(observation())


@pytest.mark.parametrize("result", [None, {"action": 0}, TensorDict({}, [1])])
def test_policy_without_an_action_is_named(result):
    with pytest.raises(ValueError, match="policy: must return a TensorDict with 'action', got"):
        RestrictedPolicy(lambda _: result)(observation())


@pytest.mark.parametrize(
    "policy, observes",
    [
        ("stand_still", []),
        ("pure_pursuit", ["pose", "path"]),
        ("dwa", ["scan", "pose", "path"]),
        ("paper", ["scan", "pose", "path"]),
        ("liang", ["scan", "pose", "path"]),
        ("oracle", ["true state"]),
        ("own_policies:ahead", ["scan", "pose", "path", "odometry"]),
        ("own_policies:Turning", ["scan"]),
    ],
)
def test_results_list_the_sources_of_observations(module, policy, observes):
    change = ["+change.controller.rate=0.1"] * policy.endswith("Turning")
    evaluated = make_evaluated_policy(
        compose("evaluate", [f"policy={policy}", "num_worlds=1", *change])
    )
    assert evaluated.observes == observes
    evaluated.close()


def test_odometry_of_a_bundle_is_listed():
    cfg = compose("evaluate", ["policy=navrl-best-predictive", "num_worlds=1"])
    assert "odometry" in make_evaluated_policy(cfg).observes
