"""``navrl-suites``: generate the frozen suites and hold them to their hashes."""

from __future__ import annotations

from omegaconf import DictConfig

from navrl.build.suites import check_suites
from navrl.config import hydra_main


@hydra_main("suites")
def main(cfg: DictConfig) -> None:
    """Print how each suite stands.

    Raises:
        ValueError: If one is not as frozen and the lock is not to be written.
    """
    wrong = []
    for suite in check_suites(cfg):
        found = suite.found
        print(
            f"{suite.name:18} version {found.version}  {found.episodes:5,} episodes  "
            f"{found.sha256}  {suite.status}",
            flush=True,
        )
        wrong += [suite.name] if suite.status != "frozen" else []
    if wrong and not cfg.write:
        raise ValueError(f"not as frozen: {', '.join(wrong)}; write=true puts them into the lock")


if __name__ == "__main__":
    main()
