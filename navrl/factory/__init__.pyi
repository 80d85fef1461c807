from .environment import make_batched_env, make_env, make_navigation_env, make_pool, set_threads
from .gymnasium import make_gymnasium_env, make_gymnasium_vector_env
from .policy import EvaluatedPolicy, bundle_folder, make_evaluated_policy, policy_name
from .training import make_agent, make_trainer, observation_shapes, save_policy

__all__ = [
    "EvaluatedPolicy",
    "bundle_folder",
    "make_agent",
    "make_batched_env",
    "make_env",
    "make_evaluated_policy",
    "make_gymnasium_env",
    "make_gymnasium_vector_env",
    "make_navigation_env",
    "make_pool",
    "make_trainer",
    "observation_shapes",
    "policy_name",
    "save_policy",
    "set_threads",
]
