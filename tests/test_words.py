"""Docstrings, comments, errors and pages use plain field English and US spelling."""

import ast
import importlib.util
import io
import re
import subprocess
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
REWRITTEN_APART = ("algos", "networks", "ops", "sim", "training", "transforms")  # of navrl
# Words without a technical meaning, with the remaining number in most texts, and in the packages
# above. Counts may only fall: a change that removes some lowers the number here.
LEFT = {
    "nobody": (0, 5),
    "somebody": (0, 1),
    "everybody": (0, 1),
    "anybody": (0, 0),
    "whoever": (0, 0),
    "whatever": (0, 8),
    "whichever": (0, 1),
    "blame": (0, 3),
    "cheat(?:s|ed|ing)?": (2, 0),
    "told": (0, 4),
    "tells?": (0, 5),
    "is worth": (0, 0),
    "no say|its say": (0, 1),
    "to the letter": (0, 0),
    "lives? in": (0, 3),
    "at home": (0, 1),
    "by itself|of itself": (0, 0),
    "goes? on|went on": (0, 5),
    "asks? the host": (0, 0),
    "strangers?": (0, 0),
    "minds?|minded": (0, 0),
    "what is no": (0, 5),
    "the way driven|way it came": (0, 0),
    "looked for": (0, 3),
    "lost": (0, 2),
    "cut off": (0, 3),
    "judged?": (0, 2),
    "rivals?": (0, 0),
    "anew|afresh": (0, 4),
    "for ever": (0, 2),
    "on the spot": (0, 2),
    "is silent": (0, 0),
}
LONG = (0, 22)  # first lines of docstrings of 90 characters or more
CLAUSES = (0, 44)  # first lines that are a clause without its noun
RAISES = (0, 24)  # entries that do not begin with "If"
MISSPELLED = (0, 68)  # by codespell


def texts() -> Iterator[tuple[Path, int, str]]:
    """Yield file, line and text of docstrings, strings, comments and pages."""
    for path in sorted((ROOT / "navrl").rglob("*.py")):
        yield from ((path, line, text) for line, text in python_texts(path.read_text()))
    for path in sorted((ROOT / "conf").rglob("*.yaml")):
        for line, text in enumerate(path.read_text().splitlines(), 1):
            yield path, line, text.partition("#")[2]
    for path in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]:
        for line, text in enumerate(path.read_text().splitlines(), 1):
            yield path, line, text


def python_texts(source: str) -> Iterator[tuple[int, str]]:
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string


def is_apart(path: Path) -> bool:
    parts = path.relative_to(ROOT).parts
    return parts[0] == "navrl" and parts[1] in REWRITTEN_APART


def docstrings() -> Iterator[tuple[Path, ast.AST, str]]:
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef)
    for path in sorted((ROOT / "navrl").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, kinds) and (text := ast.get_docstring(node)):
                yield path, node, text


def test_words_without_technical_meaning_do_not_increase():
    found = {word: ([], []) for word in LEFT}
    for path, line, text in texts():
        for word in LEFT:
            for _ in re.finditer(rf"\b(?:{word})\b", re.sub(r"\s+", " ", text), re.I):
                found[word][is_apart(path)].append(f"{path.relative_to(ROOT)}:{line}")
    for word, places in found.items():
        check_at_most(places, LEFT[word])


def test_first_lines_of_docstrings_fit_an_index():
    long, clauses = ([], []), ([], [])
    for path, node, text in docstrings():
        first = text.splitlines()[0]
        place = f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 1)}: {first}"
        if len(first) >= 90:
            long[is_apart(path)].append(place)
        if re.match(r"(?:What|How|Where|Which|Who|Whether|Some) ", first):
            clauses[is_apart(path)].append(place)
    check_at_most(long, LONG)
    check_at_most(clauses, CLAUSES)


def test_raises_sections_say_when():
    found = ([], [])
    for path, node, text in docstrings():
        section = re.search(r"^Raises:\n((?: +.*\n?)+)", text, re.M)
        for line in section[1].splitlines() if section else ():
            if re.match(r"    \S", line) and not re.match(r"    \w+: If ", line):
                place = f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 1)}: {line.strip()}"
                found[is_apart(path)].append(place)
    check_at_most(found, RAISES)


def test_spelling_is_american():
    """By codespell with the options of pyproject.toml, as in the pre-commit hook."""
    if importlib.util.find_spec("codespell_lib") is None:
        pytest.skip("needs codespell: pip install -e '.[test]'")
    command = [sys.executable, "-m", "codespell_lib", "--toml", "pyproject.toml"]
    command += ["README.md", "CONTRIBUTING.md", "mkdocs.yml", "docs", "conf", "navrl"]
    shown = subprocess.run(command, cwd=ROOT, capture_output=True, text=True).stdout
    found = ([], [])
    for line in shown.splitlines():
        found[is_apart(ROOT / line.removeprefix("./").split(":")[0])].append(line)
    check_at_most(found, MISSPELLED)


def check_at_most(found: tuple[list[str], list[str]], most: tuple[int, int]) -> None:
    for places, limit in zip(found, most, strict=True):
        assert len(places) <= limit, f"{len(places)}, at most {limit}: {places}"
