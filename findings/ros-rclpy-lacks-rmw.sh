#!/usr/bin/env bash
# ros-rclpy 9.1.2 of PyPI: what pip installs with it cannot be imported.
#
# Guess: `pip install ros-rclpy` brings all that rclpy needs, a middleware too, as a ROS distribution does.
# Seen: 21 packages are required, among them ros-rmw-implementation, which loads a middleware by name, but
# none is a middleware; `import rclpy` raises ImportError for librmw_fastrtps_cpp.so. With
# ros-rmw-fastrtps-cpp 9.3.3 it works. Messages beyond those of rclpy, e.g. ros-sensor-msgs, are apart too.
# For a user: install ros-rmw-fastrtps-cpp; navrl's extra ros2 does.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q ros-rclpy==9.1.2
import() { "$folder/venv/bin/python" -c "import rclpy; print('imported', rclpy.__name__)" 2>&1; }
if first=$(import); then echo "imported without a middleware now" && exit 1; fi
grep -o "ImportError: librmw_fastrtps_cpp.so.*" <<<"$first"
"$folder/venv/bin/pip" install -q ros-rmw-fastrtps-cpp==9.3.3
second=$(import)
echo "$second"
[ "$second" = "imported rclpy" ]
