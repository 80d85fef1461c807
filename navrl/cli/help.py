"""Help of a command, read from its primary config: what it does, groups, keys, an example."""

from __future__ import annotations

import itertools
import re
import textwrap
from collections.abc import Iterable, Iterator

import yaml

from navrl.config import CONF_DIR, options
from navrl.policies.names import zoo_names

_WIDTH, _COLUMN = 100, 34  # characters of a line, and where the comments begin
_EXAMPLE = "Example: "
_OPTIONS = {
    "--cfg job": "print the configuration, run nothing",
    "--config-dir FOLDER": "take your own configuration files too",
    "--hydra-help": "show Hydra's own options",
    "--version": "show the version of navrl",
}
_MULTIRUN = "run every combination of values that commas separate, KEY=A,B"


def help_text(config_name: str) -> str:
    """Return the help of a command.

    The header of ``conf/CONFIG_NAME.yaml`` gives the description and, after ``Example:``, the
    examples; the comment behind a key describes it. Groups and keys of the files in ``conf/base``
    that it inherits come first.

    Args:
        config_name: The command's primary config.
    """
    text = (CONF_DIR / f"{config_name}.yaml").read_text()
    comments = itertools.takewhile(lambda line: line.startswith("#"), text.splitlines())
    header = [line.lstrip("# ") for line in comments]
    examples = [line.removeprefix(_EXAMPLE) for line in header if line.startswith(_EXAMPLE)]
    about = [line for line in header if not line.startswith(_EXAMPLE)]
    files = [(text, yaml.compose(text, Loader=yaml.SafeLoader)) for text in _inherited(text)]
    sections = {
        "Groups, GROUP=OPTION": _last(e for file in files for e in _groups(*file, config_name)),
        "Keys, KEY=VALUE": _last(entry for file in files for entry in _keys(*file)),
        "Policies": _policies([root for _, root in files]),
        "Options": _options(text),
        "Examples" if len(examples) > 1 else "Example": [(line, "") for line in examples],
    }
    shown = [
        "\n".join([f"{title}:", *(_entry(*entry) for entry in entries)])
        for title, entries in sections.items()
        if entries
    ]
    return "\n\n".join(["\n".join(about), *shown])


def _inherited(text: str) -> list[str]:
    """Return the texts of the files in ``conf/base`` that a config inherits, and its own last."""
    names = [name for name in yaml.safe_load(text).get("defaults", []) if isinstance(name, str)]
    files = [CONF_DIR / "base" / f"{name.removeprefix('base/')}.yaml" for name in names]
    inherited = [_inherited(file.read_text()) for file in files if file.is_file()]
    return [*(found for texts in inherited for found in texts), text]


def _last(entries: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """Return the last entry of each key: a command may change what it inherits."""
    return list({words.partition("=")[0]: (words, comment) for words, comment in entries}.values())


def _groups(text: str, root: yaml.MappingNode, config_name: str) -> list[tuple[str, str]]:
    """Return each group of the defaults list with its default, its options and its comment."""
    found = []
    for item in _entries(root).get("defaults", yaml.SequenceNode("", [])).value:
        if not isinstance(item, yaml.MappingNode):
            continue  # _self_ or another primary config
        key, value = item.value[0]
        name = key.value.removeprefix("override ")
        name = name.removeprefix("/")
        names = ", ".join(_group_options(name.partition("@")[0], config_name))
        if names and not name.startswith("hydra/"):
            default = text[value.start_mark.index : value.end_mark.index]
            found.append((f"{name}={default}", _joined(names, _comment(text, value))))
    return found


def _group_options(group: str, config_name: str) -> list[str]:
    """Return the options of a group; of the sweeps only those of this command."""
    names = options(group)
    if group == "sweep":
        texts = {name: (CONF_DIR / group / f"{name}.yaml").read_text() for name in names}
        names = [name for name, text in texts.items() if f"outputs/{config_name}/" in text]
    return names


def _keys(text: str, node: yaml.MappingNode, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield ``KEY=VALUE`` and comment of each key, those of block mappings one by one."""
    for key, value in node.value:
        name = f"{prefix}{key.value}"
        if name in ("defaults", "hydra"):
            continue
        if isinstance(value, yaml.MappingNode) and not value.flow_style:
            comment = _comment(text, key).removeprefix(":").lstrip("# ")
            if comment:
                yield f"{name}.*", comment
            yield from _keys(text, value, f"{name}.")
        else:
            shown = text[value.start_mark.index : value.end_mark.index]
            comment = _comment(text, value)
            yield f"{name}={shown}", f"required; {comment}" if shown == "???" else comment


def _policies(roots: list[yaml.MappingNode]) -> list[tuple[str, str]]:
    if not any("policy" in _entries(root) for root in roots):
        return []
    return [("zoo", ", ".join(zoo_names())), ("controllers", ", ".join(options("controller")))]


def _options(text: str) -> list[tuple[str, str]]:
    folder = re.search(r'run: \{dir: "(outputs/\w+)/\$\{now', text)
    if folder is None:  # the command has no folder of results
        return list(_OPTIONS.items())
    place = f"folder of the results; {folder[1]}/TIME if not given"
    return [("hydra.run.dir=FOLDER", place), ("-m, --multirun", _MULTIRUN), *_OPTIONS.items()]


def _entries(node: yaml.MappingNode) -> dict[str, yaml.Node]:
    return {key.value: value for key, value in node.value}


def _comment(text: str, node: yaml.Node) -> str:
    """Return the comment behind a node, in its line."""
    rest = text[node.end_mark.index :].partition("\n")[0]
    return rest.partition("#")[2].strip()


def _joined(names: str, comment: str) -> str:
    return f"{names} ({comment})" if comment else names


def _entry(words: str, comment: str) -> str:
    """Return an entry whose comment begins at a fixed column, on a line of its own if need be."""
    first = f"  {words}"
    if not comment:
        return first
    lines = textwrap.wrap(comment, _WIDTH - _COLUMN, break_on_hyphens=False)
    if len(first) < _COLUMN - 1:
        lines[0] = first.ljust(_COLUMN) + lines[0]
        head = []
    else:
        head = [first]
        lines[0] = " " * _COLUMN + lines[0]
    return "\n".join([*head, lines[0], *(" " * _COLUMN + line for line in lines[1:])])
