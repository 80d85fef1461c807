#!/usr/bin/env bash
# RVO2 (pyrvo 0.4.3) parts two overlapping agents, but leaves an agent inside a wall's margin.
#
# Guess, written down first: an agent that stands nearer to a wall than its radius is pushed out,
# as two overlapping agents are pushed apart.
# Seen: the agents part within a step; the agent at the wall never moves, whatever the time.
# For a user: keep walls away by a margin of your own; the library forbids coming nearer only.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q pyrvo==0.4.3
"$folder/venv/bin/python" - <<'PY'
import pyrvo

simulator = pyrvo.RVOSimulator()
simulator.set_time_step(0.1)
simulator.set_agent_defaults(5.0, 10, 2.0, 2.0, 0.5, 1.0, (0.0, 0.0))  # radius 0.5 m
simulator.add_obstacle([(-5.0, -1.0), (5.0, -1.0), (5.0, 0.0), (-5.0, 0.0)])  # counter-clockwise
simulator.process_obstacles()
at_wall = simulator.add_agent((0.0, 0.2))  # 0.3 m too near to the edge y = 0
pair = [simulator.add_agent((20.0, 20.0)), simulator.add_agent((20.4, 20.0))]  # 0.6 m too near
for agent in (at_wall, *pair):
    simulator.set_agent_pref_velocity(agent, (0.0, 0.0))
for _ in range(50):
    simulator.do_step()
wall_gap = simulator.get_agent_position(at_wall).y
apart = simulator.get_agent_position(pair[1]).x - simulator.get_agent_position(pair[0]).x
print(f"agent and wall after 5 s: {wall_gap:.3f} m (radius 0.5 m); two agents: {apart:.3f} m")
assert abs(wall_gap - 0.2) < 1e-6, "the wall now pushes"
assert apart >= 0.999, "the agents no longer part"
PY
