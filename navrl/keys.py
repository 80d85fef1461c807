"""TensorDict keys of navrl with meaning, shape, unit and frame.

Shapes are batch first and feature last; ``*B`` is any batch shape. Frames: *world* is the fixed map
frame, *robot* has x forward and y left, and angles grow counter-clockwise. Transforms accept any
keys; these are the defaults.
"""

from navrl.deprecation import renamed_attributes

# --- raw outputs of the environment --------------------------------------------------------------
RANGES = "ranges"  # [*B, beams] m, beam j at 2*pi*j/beams in the lidar's frame; maximum = no return
MEASURED = "measured"  # [*B, beams] bool, not blind; only for a lidar with blind beams
POSE = "pose"  # [*B, 3] (x, y, yaw) of the robot, world
VELOCITY = "velocity"  # [*B, C] velocity of the robot now, e.g. (v, w), m/s and rad/s
COMMAND = "command"  # [*B, C] last command, e.g. (v, w), m/s and rad/s; zero after a reset
PATH = "path"  # [*B, P, 2] global path, world, padded by repeating the goal
# When a command given now takes effect, by the commands under way; the present without delays:
MOTION_AHEAD = "motion_ahead"  # [*B, 3] (x, y, yaw), robot at that time, robot frame now
VELOCITY_AHEAD = "velocity_ahead"  # [*B, C] velocity at that time, e.g. (v, w), m/s and rad/s
SCAN_MOTION = "scan_motion"  # [*B, 2, 3] (x, y, yaw), robot at first and last beam, robot frame now

# --- outputs of the transforms -------------------------------------------------------------------
# The scan of another lidar as one of the policy's own, of ScanAdapter under a perturbation.
RANGES_ADAPTED = "ranges_adapted"  # [*B, beams of the policy] m, as ranges
MEASURED_ADAPTED = "measured_adapted"  # [*B, beams of the policy] bool, seen by the lidar
# The scan before MotionCompensation, in the robot's frame at the time of each beam.
RANGES_MEASURED = "ranges_measured"  # [*B, N] m
POINTS_MEASURED = "points_measured"  # [*B, N, 2] m
RETURNS_MEASURED = "returns_measured"  # [*B, N] bool
RANGES_POOLED = "ranges_pooled"  # [*B, N] m, from the robot's center, bin 0 straight ahead
POINTS = "points"  # [*B, N, 2] m, scan t, robot frame at t
RETURNS = "returns"  # [*B, N] bool, the point is a return
SEEN = "seen"  # [*B, N] bool, the lidar covers the bin; only for less than a full circle
POINTS_FULL = "points_full"  # [*B, N, 2] m, scan t to the sensor's full range, robot frame at t
RETURNS_FULL = "returns_full"  # [*B, N] bool
PREVIOUS_POINTS_FULL = "points_full_previous"  # [*B, N, 2] m, scan t-1, robot frame at t-1
PREVIOUS_RETURNS_FULL = "returns_full_previous"  # [*B, N] bool
POSE_AHEAD = "pose_ahead"  # [*B, 3] (x, y, yaw) of the robot at that time, world
SCAN_MOTION_AHEAD = "scan_motion_ahead"  # [*B, 2, 3] scan_motion in the robot frame at that time
PREVIOUS_POSE = "pose_previous"  # [*B, 3] (x, y, yaw) at t-1, world
PREVIOUS_POINTS = "points_previous"  # [*B, N, 2] m, scan t-1, robot frame at t-1
PREVIOUS_RETURNS = "returns_previous"  # [*B, N] bool
ALIGNED_POINTS = "points_aligned"  # [*B, N, 2] m, scan t-1, robot frame at t
ICP_TRANSFORM = "icp_transform"  # [*B, 3] T_target_source (x, y, yaw) of frame t-1 in frame t
ICP_CONVERGED = "icp_converged"  # [*B, 1] bool
ICP_INLIERS = "icp_inliers"  # [*B, 1] int64, matched pairs of the last iteration
ICP_QUALITY = "icp_quality"  # [*B, 4] share of inliers, their RMS residual m, two eigenvalues
TAGD = "tagd"  # [*B, N_c, 4] m, (c_{t-1}, c_t), robot frame at t
TAGD_VALID = "tagd_valid"  # [*B, N_c, 2] bool, whether the group at t-1 / t has points
POINTS_HISTORY = "points_history"  # [*B, K, N, 2] m, scans t-1 to t-K, robot frame at t
RANGES_HISTORY = "ranges_history"  # [*B, K + 1, N] m, scans t to t-K by bearing, frame t
FLOW_POINTS = "flow_points"  # [*B, K, N, 2] m, as points_history, for EstimateFlow
FLOW_RANGES = "flow_ranges"  # [*B, K + 1, N] m, as ranges_history, for EstimateFlow
FLOW = "flow"  # [*B, N, 4] m, previous and present position of each return, robot frame at t
FLOW_VALID = "flow_valid"  # [*B, N, 2] bool, the point is a return, for both positions
TRACKS = "tracks"  # [*B, G, 4] m, previous and present position of what moves, robot frame at t
TRACKS_VALID = "tracks_valid"  # [*B, G, 2] bool, followed to scan t-1 / moving returns in scan t
TRACKS_POINTS = "tracks_points"  # [*B, K, N, 2] m, moving returns of t-1 to t-K, frame t, or far
WAYPOINTS = "waypoints"  # [*B, N_f, 2] m, robot frame
GOAL = "goal_position"  # [*B, 2] m, end of the path, robot frame
PATH_PROGRESS = "path_progress"  # [*B, 1] m, arc length of the robot's projection on the path
TRAIL = "trail"  # [*B, M, 2] m from the path's first point, world axes, since it was in sight
TRAIL_STATE = "trail_state"  # [*B, 2] points of the trail, and time the path was out of sight s
STALL = "stall"  # [*B, 2] largest progress m, and time since it was reached s
# What Recovery reads behind a Retreat in place of waypoints and stall, and state of the retreat.
RECOVERY_WAYPOINTS = "recovery_waypoints"  # [*B, N_f, 2] m, robot frame
RECOVERY_STALL = "recovery_stall"  # [*B, 2] as stall; 0 while the policy drives
RETREAT = (
    "retreat"  # [*B, 3] target m, robot frame; 1 in a retreat, 2 while the policy drives, or 0
)

# --- inputs of the networks (scaled to about [-1, 1]) --------------------------------------------
SPATIAL_INPUT = "spatial"  # [*B, N, 2]
SPATIAL_PREVIOUS_INPUT = "spatial_previous"  # [*B, N, 2], only for the NO-TAGD ablation
TEMPORAL_INPUT = "temporal"  # [*B, N_c, 4]
WAYPOINTS_SCALED = "waypoints_scaled"  # [*B, N_f, 2]
RANGES_POOLED_SCALED = "ranges_pooled_scaled"  # [*B, N], scan of the baselines
RANGES_HISTORY_SCALED = "ranges_history_scaled"  # [*B, K + 1, N] current and past ranges, aligned
GOAL_SCALED = "goal_position_scaled"  # [*B, 2]

# --- outputs of the agent ------------------------------------------------------------------------
# (v, w), m/s and rad/s, in the environment; in [-1, 1] at the policy, where its meaning depends on
# the transforms: (v, w) or a subgoal
ACTION = "action"  # [*B, 2]
STATE_ACTION_VALUE = "state_action_value"  # [*B, 1]
SPATIAL_ATTENTION = "spatial_attention"  # [*B, N_b] softmax weights over sectors, sum 1
TEMPORAL_ATTENTION = "temporal_attention"  # [*B, N_c] softmax weights over descriptors, sum 1

# --- outcome of a step ---------------------------------------------------------------------------
OUTCOME = "outcome"  # [*B, 1] int64, navrl.envs.Outcome
CONTACT = "contact"  # [*B, 1] int64, navrl.sim.Contact
REWARD_TERMS = "reward_terms"  # nested {term: [*B, 1]}, weighted; they sum to the reward

# --- privileged (true state, not available to lidar policies) ------------------------------------
TRUE_POSE = "true_pose"  # [*B, 3], world; only if the reported pose is not exact
PEDESTRIAN_BOXES = "pedestrian_boxes"  # [*B, K, 5] (cx, cy, hx, hy, yaw), world; NaN where absent
PEDESTRIAN_CLEARANCE = "pedestrian_clearance"  # [*B, 1] m, surface to surface; inf without any

# --- exploration, from step to step ---------------------------------------------------------------
EXPLORATION_NOISE = "exploration_noise"  # [*B, C] unit variance; NaN where an episode starts

# --- only between workers and learner ------------------------------------------------------------
WORKER = "worker"  # [*B, 1] int64, index of the worker
MAX_DYNAMIC = "max_dynamic"  # [*B, 1] int64, curriculum level of new episodes

__getattr__ = renamed_attributes(
    __name__,
    {
        "WAYPOINT_INPUT": "WAYPOINTS_SCALED",
        "DISTANCE_INPUT": "RANGES_POOLED_SCALED",
        "DISTANCES_INPUT": "RANGES_HISTORY_SCALED",
        "GOAL_INPUT": "GOAL_SCALED",
    },
)
