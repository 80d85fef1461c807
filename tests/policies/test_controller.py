"""Controllers report about themselves: privileged, required packages, a known future."""

import pytest
from models import Fleeing

from navrl.config import CONF_DIR, compose
from navrl.evaluation import summarize
from navrl.evaluation.reference import is_privileged
from navrl.evaluation.stored import Evaluation
from navrl.factory import make_evaluated_policy
from navrl.factory.policy import controller_class, controller_node
from navrl.policies.controller import Controller, missing_packages

NAMES = sorted(path.stem for path in (CONF_DIR / "controller").glob("*.yaml"))
TINY = ["num_worlds=1", "num_threads=1", "suite=smoke"]


def test_controllers_that_read_the_true_state_are_privileged():
    assert {name for name in NAMES if controller_class(name).privileged} == {"oracle", "orca"}
    assert {
        name: controller_class(name).requires for name in NAMES if controller_class(name).requires
    } == {"orca": ("pyrvo",)}


def test_missing_packages_are_named():
    class Mine(Controller):
        requires = ("no_such_module", "torch")

    assert missing_packages(Mine) == ["no_such_module"]
    assert missing_packages(lambda td: td) == []


@pytest.mark.parametrize("policy, expected", [("orca", True), ("oracle", True), ("paper", False)])
def test_older_summaries_are_privileged_by_name(tmp_path, policy, expected):
    assert is_privileged(Evaluation(tmp_path, {"policy": policy})) is expected
    assert (
        is_privileged(Evaluation(tmp_path, {"policy": policy, "privileged": not expected}))
        is not expected
    )


def test_oracle_rejects_reactive_pedestrians():
    cfg = compose("evaluate", [*TINY, "policy=oracle", "pedestrians._target_=models.Fleeing"])
    with pytest.raises(ValueError, match="pedestrians=Fleeing: must not be reactive, Oracle plans"):
        make_evaluated_policy(cfg)
    cfg.policy = "pure_pursuit"
    evaluated = make_evaluated_policy(cfg)
    assert isinstance(evaluated.env.base_env.simulator.pedestrians, Fleeing)
    evaluated.env.close()


@pytest.mark.parametrize("path", ["../suite/smoke", "/tmp/mine", "controller/dwa", "./dwa"])
def test_path_to_a_node_is_not_a_policy(path):
    with pytest.raises(ValueError, match=f"policy={path}: no such bundle or controller"):
        controller_node(path)


def test_summary_states_whether_the_policy_is_privileged():
    from navrl.evaluation import EpisodeRecord

    record = EpisodeRecord(0, "office", "timeout", 1, 0.2, 0.0, 1.0)
    settings = {"policy": "mine", "suite": "s", "suite_hash": "h", "simulator": "B"}
    assert summarize([record], **settings, privileged=True)["privileged"] is True
