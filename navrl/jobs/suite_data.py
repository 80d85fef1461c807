"""Files of a suite that are not part of navrl; imports neither torch nor the files."""

from __future__ import annotations

from pathlib import Path

from omegaconf import DictConfig


def missing_data(cfg: DictConfig) -> str | None:
    """Return why a suite of files cannot be played here; ``None`` if it can.

    Raises:
        ValueError: If a suite of files has no folder, or it is a file.
    """
    folder = cfg.suite.get("distribution", {}).get("folder")
    if "folder" not in cfg.suite.get("distribution", {}):
        return None
    if folder is None:
        raise ValueError(f"data=null: must be a folder for suite={cfg.suite.name}, docs/places.md")
    if Path(folder).is_dir():
        return None
    if Path(folder).exists():
        raise ValueError(f"data={folder}: must be a folder of files, is a file")
    return f"suite={cfg.suite.name}: skipped, data={folder} does not exist"
