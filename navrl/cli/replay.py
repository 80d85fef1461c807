"""``navrl-replay``: replay a bag or log through a policy."""

from __future__ import annotations

import logging

from omegaconf import DictConfig

from navrl.cli.command import hydra_main, missing_extras
from navrl.cli.logs import checked_folder

log = logging.getLogger(__name__)


@hydra_main("replay", argument="bag")
def main(cfg: DictConfig) -> None:
    """Replay ``cfg.bag`` and report what the policy would have done."""
    folder = checked_folder(cfg)
    from navrl.jobs.replaying import run_replay  # imports torch

    with missing_extras():
        found = run_replay(cfg, folder)
    states = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in found["states_s"].items())
    log.info("%s on %s: %d decisions; %s", found["policy"], cfg.bag, found["decisions"], states)
    if found["shielded"]:
        log.info("the shield replaced %d commands", found["shielded"])
    aligned = found["alignment"]
    if aligned["moving_within"] is not None:
        share = 100.0 * aligned["moving_within"]
        text = "alignment: %.1f %% of %d moving pairs within 0.1 m and 2 degrees of the poses"
        log.info(text, share, aligned["moving"])
    for reason, count in found["rejected"].items():
        log.warning("%d inputs refused: %s", count, reason)
    if found["mount_source"].startswith("assumed"):
        log.warning("mount=%s: assumed, the log has none; give mount=[x,y,yaw]", found["mount"])
    log.info("%s", folder)


if __name__ == "__main__":
    main()
