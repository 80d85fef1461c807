"""TorchRL transforms from raw lidar, pose and path to the inputs of the networks.

Transforms only hold parameters. State that must persist from step to step is a TensorDict key, so
the transforms work with any TorchRL environment.
"""

from navrl.transforms.action_shield import ActionShield
from navrl.transforms.base_motion import Base
from navrl.transforms.command_rate_limit import CommandRateLimit
from navrl.transforms.forward_speeds import ForwardSpeeds
from navrl.transforms.goal_position import GoalPosition
from navrl.transforms.icp_align import ICPAlign
from navrl.transforms.min_pool import MinPool
from navrl.transforms.motion_compensation import MotionCompensation
from navrl.transforms.motion_prediction import MotionPrediction
from navrl.transforms.normalize import Normalize
from navrl.transforms.observation_map import ObservationMap, flag_spec, real_spec
from navrl.transforms.pipeline import compose
from navrl.transforms.range_history import RangeHistory
from navrl.transforms.recovery import Recovery
from navrl.transforms.retreat import Retreat
from navrl.transforms.returning_waypoints import ReturningWaypoints
from navrl.transforms.scan_adapter import ScanAdapter
from navrl.transforms.scan_flow import EstimateFlow
from navrl.transforms.scan_history import ScanHistory
from navrl.transforms.stall_timer import StallTimer
from navrl.transforms.subgoal_action import SubgoalAction
from navrl.transforms.tagd import TAGD
from navrl.transforms.track_flow import TrackFlow
from navrl.transforms.waypoints import Waypoints

__all__ = [
    "TAGD",
    "ActionShield",
    "Base",
    "CommandRateLimit",
    "EstimateFlow",
    "ForwardSpeeds",
    "GoalPosition",
    "ICPAlign",
    "MinPool",
    "MotionCompensation",
    "MotionPrediction",
    "Normalize",
    "ObservationMap",
    "RangeHistory",
    "Recovery",
    "Retreat",
    "ReturningWaypoints",
    "ScanAdapter",
    "ScanHistory",
    "StallTimer",
    "SubgoalAction",
    "TrackFlow",
    "Waypoints",
    "compose",
    "flag_spec",
    "real_spec",
]
