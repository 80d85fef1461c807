"""Composition of configurations and reporting of configuration errors."""

from __future__ import annotations

import difflib
import hashlib
import inspect
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, cast

import hydra
import yaml
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException, InstantiationException
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException

from navrl.deprecated_groups import check_groups, renamed_overrides
from navrl.deprecation import RENAMED_GROUPS, present_key, renamed_attributes
from navrl.files import explain_os_error

CONF_DIR = next(
    folder.resolve()
    for folder in (Path(__file__).parent / "conf", Path(__file__).parent.parent / "conf")
    if folder.is_dir()
)
"""Folder of configurations: inside the package in a wheel, beside it in a clone."""

_BASE = "base"  # folder of configurations that are inherited, not chosen
_LONGEST_NAME = 120  # characters of a folder's name; file systems allow 255 bytes

USER_ERRORS = (ValueError, OSError, yaml.YAMLError, HydraException, OmegaConfBaseException)
"""What a user can get wrong: reported in one line."""


def folder_name(*parts: object) -> str:
    """Join parts to a readable folder name; the resolver ``${folder_name:...}`` of configs.

    Args:
        parts: Joined by ``_`` without empty ones. Characters that need quoting in a shell become
            ``-``, and a name that is too long is shortened and gets a hash.
    """
    whole = "_".join(str(part) for part in parts if part not in (None, ""))
    name = re.sub(r"[\[\]{}'\"]+", "", whole)
    name = re.sub(r"[^\w.,=+-]+", "-", name).strip("-.") or "job"
    if len(name) <= _LONGEST_NAME:
        return name
    return f"{name[: _LONGEST_NAME - 9]}-{hashlib.sha256(whole.encode()).hexdigest()[:8]}"


OmegaConf.register_new_resolver("folder_name", folder_name, replace=True)


def _register_families() -> dict[str, list[str]]:
    """Make an option of each member of the files ``conf/GROUP/family/*.yaml``.

    The values of such a file are those of all its ``members``, unless a member has its own.

    Returns:
        Names of the members by group.
    """
    names: dict[str, list[str]] = {}
    for file in sorted(CONF_DIR.glob("*/family/*.yaml")):
        group, shared = file.parent.parent.name, cast(DictConfig, OmegaConf.load(file))
        for name, own in shared.pop("members").items():
            node = OmegaConf.to_container(OmegaConf.merge(shared, own))
            ConfigStore.instance().store(name, node, group, provider=str(file))
            names.setdefault(group, []).append(name)
    return names


_MEMBERS = _register_families()


def compose(config_name: str | None, overrides: Sequence[str] = ()) -> DictConfig:
    """Compose a config as on the command line.

    Args:
        config_name: Primary config, e.g. ``train``; ``None`` for the overrides alone.
        overrides: Hydra overrides, e.g. ``["scenario=corridor", "seed=1"]``.

    Returns:
        The config; interpolations are resolved on access.

    Raises:
        ValueError: If a file of the user has a group under a deprecated name.
    """
    overrides = renamed_overrides(overrides)
    if GlobalHydra.instance().is_initialized():  # in a command: use its search path
        cfg = hydra.compose(config_name, overrides)
    else:
        with hydra.initialize_config_dir(version_base="1.3", config_dir=str(CONF_DIR)):
            cfg = hydra.compose(config_name, overrides)
    check_groups(cfg)
    return cfg


def compose_or_name(config_name: str, overrides: Sequence[str]) -> DictConfig:
    """Compose a config for a caller in Python, to whom Hydra's errors would be several lines.

    Raises:
        ValueError: If an override is wrong; one line, with the nearest names.
    """
    try:
        return compose(config_name, overrides)
    except (HydraException, OmegaConfBaseException) as error:
        line = describe(error)
        hint = nearest_names(line, config_name)
        raise ValueError(line.removesuffix(".") + hint if hint else line) from error


def options(group: str) -> list[str]:
    """Return the names that a configuration group offers, a user's own among them.

    Inside a command its search path counts (``--config-dir``, ``hydra.searchpath``), else navrl's
    own configurations.
    """
    if GlobalHydra.instance().is_initialized():
        return sorted(set(GlobalHydra.instance().config_loader().get_group_options(group)))
    files = [path.stem for path in (CONF_DIR / group).glob("*.yaml")]
    return sorted([*files, *_MEMBERS.get(group, [])])


def instantiate(node: Any, **kwargs: Any) -> Any:
    """Build a node with ``_target_``; nested lists and dicts become plain Python objects."""
    return hydra.utils.instantiate(node, _convert_="all", **kwargs)


def set_default(cfg: DictConfig, key: str, value: Any) -> None:
    """Set a value or node of a composed config, replacing an existing one."""
    with open_dict(cfg):
        cfg[key] = value


def target_packages(cfg: DictConfig) -> set[str]:
    """Return the top-level packages of all targets of a config."""
    return {
        str(value).partition(".")[0]
        for name, value in _leaves(cfg)
        if name.endswith("_target_") and value is not None
    }


def describe(error: BaseException) -> str:
    """Return a one-line description of an error and its place."""
    place = allowed = ""
    while isinstance(error, InstantiationException):
        match = re.search(r"full_key: (\S+)", str(error))
        place = f"{match[1]}: " if match else place
        allowed = _arguments_of(str(error)) or allowed
        if error.__cause__ is None:
            break
        error = error.__cause__
    shown = explain_os_error(error) if isinstance(error, OSError) else str(error)
    text = re.sub(r"\s+", " ", shown).strip()
    text = re.sub(r"(full_key|object_type|reference_type)[:=] ?\S*", "", text).strip()
    text = re.sub(rf"^In '({_BASE}/)?\w+': ", "", text.partition(" Config search path:")[0])
    text = re.sub(r"\. To append to your config use \+controller\.\S*", ".", text)
    taken = re.match(r"'([\w/]+)' is validated against ConfigStore schema", text)
    if taken is not None:
        text = f"{taken[1]}: must have another name, navrl has an option of this one"
    name = "" if isinstance(error, USER_ERRORS) else f"{type(error).__name__}: "
    return f"{place}{name}{text}" + (allowed if isinstance(error, TypeError) else "")


def _arguments_of(message: str) -> str:
    """Return the arguments of the target of a failed call."""
    match = re.search(r"call to target '([\w.]+)'", message)
    if match is None:
        return ""
    try:
        names = list(inspect.signature(hydra.utils.get_object(match[1])).parameters)
    except Exception:  # the hint must never hide the error
        return ""
    return f"; arguments are {', '.join(names)}"


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return a hint with the names nearest to a misspelt one, or an empty text."""
    known = sorted(known)
    near = difflib.get_close_matches(name, known, n=3, cutoff=0.7)
    near = near or [one for one in known if one.startswith(f"{name}_")][:3]  # a family of names
    return f"; did you mean {' or '.join(near)}?" if near else ""


def nearest_names(line: str, config_name: str) -> str:
    """Return what a mistyped key or option may have meant.

    Args:
        line: An error of Hydra's, in one line.
        config_name: The command's primary config.
    """
    option = re.search(r"Could not find '([\w/]+)/([^/']+)'", line)
    if option is not None:
        old = [name for name, new in RENAMED_GROUPS.items() if new == option[1]]
        moved = f"; your own options of {old[0]}/ belong in {option[1]}/ now" if old else ""
        return did_you_mean(option[2], options(option[1])) or moved
    key = re.search(r"[Cc]ould not override '([^']+)'", line) or re.search(
        r"Key '([^']+)' is not in struct", line
    )
    if key is None:
        return ""
    group, _, name = key[1].partition(".")
    if group == "controller":
        return f"; +change.controller.{present_key(name)}=... changes the policy's controller"
    if key[1] in RENAMED_GROUPS:
        new = RENAMED_GROUPS[key[1]]
        return f"; the group is {new} now: write 'override /{new}' in this file"
    try:
        known = [name for name, _ in _leaves(compose(config_name))] + _groups()
    except Exception:  # the hint must never hide the error
        return ""
    return did_you_mean(key[1], {name for name in known if not name.endswith("_")})  # no _target_


def _groups() -> list[str]:
    return [
        folder.name for folder in CONF_DIR.iterdir() if folder.is_dir() and folder.name != _BASE
    ]


def _leaves(cfg: DictConfig, prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key in map(str, cfg):
        name = f"{prefix}{key}"
        if OmegaConf.is_interpolation(cfg, key) or OmegaConf.is_missing(cfg, key):
            yield name, None
        elif isinstance(cfg[key], DictConfig):
            yield name, None
            yield from _leaves(cfg[key], f"{name}.")
        else:
            yield name, cfg[key]


def check_types(
    config_name: str, overrides: Sequence[str], composed: DictConfig | None = None
) -> None:
    """Check that each overridden value has the type of the default.

    Args:
        config_name: Primary config, e.g. ``train``.
        overrides: Hydra overrides of the config.
        composed: The config with these overrides, if it was composed already.

    Raises:
        ValueError: If a type differs; the message has the key, its value and the required type.
    """
    overrides = list(overrides)
    parts = [override.lstrip("+~").partition("=") for override in overrides]
    groups = [o for o, (key, _, _) in zip(overrides, parts, strict=True) if "." not in key]
    groups = [o for o in groups if o.lstrip("+~").partition("=")[0] in _groups()]
    try:
        defaults = dict(_leaves(compose(config_name, groups)))
    except (HydraException, OmegaConfBaseException):
        return  # a user's own group has no defaults
    chosen = dict(_leaves(compose(config_name, overrides) if composed is None else composed))
    for key, _, _ in parts:
        default, value = defaults.get(key), chosen.get(key)
        if default is None or value is None or isinstance(value, type(default)):
            continue
        if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
            continue
        raise ValueError(f"{key}={value}: must be {type(default).__name__}, as in {key}={default}")


__getattr__ = renamed_attributes(__name__, {"hydra_main": "navrl.cli.command.hydra_main"})
