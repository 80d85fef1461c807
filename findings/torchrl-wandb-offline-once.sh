#!/usr/bin/env bash
# TorchRL 0.14.1, wandb 0.31.0: offline=True of WandbLogger is decided by the first run of the process.
#
# Guess, written down first: WandbLogger(offline=True) concerns that logger's run only, as wandb's own
# mode="offline" does; a logger made afterwards without it is online, one made with it is offline.
# Seen: it sets WANDB_MODE=dryrun for the whole process, and wandb reads that variable once.
# - The first run decides: after an offline=True run a logger with offline=False is offline too,
#   without a warning, so nothing reaches the server.
# - After any other run in the process, here one with mode="offline", offline=True has no effect:
#   wandb wants to log in and raises UsageError where there is no key.
# For a user: pass mode="offline" (or "online") in place of offline=True.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q torch==2.13.0 torchrl==0.14.1 tensordict==0.14.3 wandb==0.31.0
cd "$folder"
unset WANDB_MODE WANDB_API_KEY
export WANDB_SILENT=true HOME=$folder # no key of the user's

echo "offline=True first:"
"$folder/venv/bin/python" - <<'PY' 2>/dev/null
import os

from torchrl.record.loggers.wandb import WandbLogger

first = WandbLogger("first", project="drives", save_dir=".", offline=True)
first.experiment.finish()
print("  WANDB_MODE =", os.environ.get("WANDB_MODE"))
assert os.environ["WANDB_MODE"] == "dryrun"
second = WandbLogger("second", project="drives", save_dir=".", offline=False)
print("  second logger, offline=False: offline is", second.experiment.offline)
assert second.experiment.offline
second.experiment.finish()
PY

echo "mode='offline' first:"
"$folder/venv/bin/python" - <<'PY' 2>/dev/null
import os

from torchrl.record.loggers.wandb import WandbLogger
from wandb.errors import UsageError

first = WandbLogger("first", project="drives", save_dir=".", mode="offline")
assert first.experiment.offline
first.experiment.finish()
print("  WANDB_MODE =", os.environ.get("WANDB_MODE"))
assert "WANDB_MODE" not in os.environ
try:
    WandbLogger("second", project="drives", save_dir=".", offline=True)
except UsageError as error:
    print("  second logger, offline=True: UsageError:", error)
else:
    raise SystemExit("offline=True is offline now")
PY
