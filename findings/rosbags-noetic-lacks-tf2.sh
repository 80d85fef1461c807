#!/usr/bin/env bash
# rosbags 0.11.9: of all its type stores, that of ROS 1 lacks the message of /tf.
#
# Guess: the store of ROS1_NOETIC knows the messages of a desktop installation, tf2_msgs/TFMessage
# among them, as those of ROS 2 do; code that writes a bag with /tf works for both.
# Seen: every store of a ROS 2 distribution has tf2_msgs/msg/TFMessage; that of ROS 1 has 164
# types, tf/tfMessage among none of them, and the lookup raises KeyError.
# For a user: register the definition, get_types_from_msg, before writing tf into a ROS 1 bag.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q rosbags==0.11.9
"$folder/venv/bin/python" - <<'PY'
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

NAME = "tf2_msgs/msg/TFMessage"
stores = {store.name: get_typestore(store) for store in Stores if store is not Stores.EMPTY}
without = sorted(name for name, store in stores.items() if NAME not in store.types)
print("stores without", NAME, without)
assert without == ["ROS1_NOETIC"], "other stores lack it now"
noetic = stores["ROS1_NOETIC"]
others = [name for name in noetic.types if name.startswith("tf")]
print("types of ROS1_NOETIC that begin with tf:", others)
assert not others
try:
    noetic.types[NAME]
except KeyError as error:
    print("lookup: KeyError", error)
noetic.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", NAME))
assert NAME in noetic.types
print("after get_types_from_msg and register: known")
PY
