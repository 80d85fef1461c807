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

from navrl import keys

ROOT = Path(__file__).parents[1]
WORDS = (  # without a technical meaning
    "nobody",
    "somebody",
    "everybody",
    "anybody",
    "whoever",
    "whatever",
    "whichever",
    "blame",
    "cheat(?:s|ed|ing)?",
    "told",
    "tells?",
    "is worth",
    "no say|its say",
    "to the letter",
    "lives? in",
    "at home",
    "by itself|of itself",
    "goes? on|went on",
    "asks? the host",
    "strangers?",
    "minds?|minded",
    "what is no",
    "the way driven|way it came",
    "looked for",
    "lost",
    "cut off",
    "judged?",
    "rivals?",
    "anew|afresh",
    "for ever",
    "on the spot",
    "is silent",
)
TEST_WORDS = (  # the same, in names of tests
    *("nobody", "somebody", "everybody", "anybody", "whoever", "whatever", "wherever"),
    *("blame", "cheats?", "told", "tells?", "says?", "said", "minds?", "strangers?", "anew"),
    *("asked", "unasked", "alone_nothing", "goes_on", "went_on", "on_the_spot", "lost"),
    *("what", "who", "whom", "refused?", "survives?", "heals?", "forgets?", "believed"),
    *("stands_still", "stands?_beside", "by_hand", "left_alone", "no_more", "somewhere"),
)
MAX_NAME = 60  # characters of a test's name


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
            if re.fullmatch(r"[\w.]+", node.value):
                continue  # a name, such as that of a deprecated alias
            yield node.lineno, node.value
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string


def docstrings() -> Iterator[tuple[Path, ast.AST, str]]:
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef)
    for path in sorted((ROOT / "navrl").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, kinds) and (text := ast.get_docstring(node)):
                yield path, node, text


def test_texts_have_no_words_without_technical_meaning():
    pattern = re.compile(rf"\b(?:{'|'.join(WORDS)})\b", re.I)
    found = [
        f"{path.relative_to(ROOT)}:{line}: {match[0]}"
        for path, line, text in texts()
        for match in pattern.finditer(re.sub(r"\s+", " ", text))
    ]
    assert not found


def test_first_lines_of_docstrings_fit_an_index():
    long, clauses = [], []
    for path, node, text in docstrings():
        first = text.splitlines()[0]
        place = f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 1)}: {first}"
        if len(first) >= 90:
            long.append(place)
        if re.match(r"(?:What|How|Where|Which|Who|Whether|Some) ", first):
            clauses.append(place)
    assert not long
    assert not clauses, "these have no noun or verb"


def test_raises_sections_state_a_condition():
    found = []
    for path, node, text in docstrings():
        section = re.search(r"^Raises:\n((?: +.*\n?)+)", text, re.M)
        for line in section[1].splitlines() if section else ():
            if re.match(r"    \S", line) and not re.match(r"    \w+: If ", line):
                place = f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 1)}"
                found.append(f"{place}: {line.strip()}")
    assert not found


def test_spelling_is_american():
    """By codespell with the options of pyproject.toml, as in the pre-commit hook."""
    if importlib.util.find_spec("codespell_lib") is None:
        pytest.skip("needs codespell: pip install -e '.[test]'")
    command = [sys.executable, "-m", "codespell_lib", "--toml", "pyproject.toml"]
    command += ["README.md", "CONTRIBUTING.md", "mkdocs.yml", "docs", "conf", "navrl", "tests"]
    assert not subprocess.run(command, cwd=ROOT, capture_output=True, text=True).stdout


def test_test_names_are_short_standard_terms():
    pattern = re.compile(rf"_(?:{'|'.join(TEST_WORDS)})_")
    names = {
        f"{path.relative_to(ROOT)}:{node.lineno}: {node.name}"
        for path in (ROOT / "tests").rglob("test_*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
        if len(node.name) > MAX_NAME or pattern.search(f"{node.name}_")
    }
    assert not names


def test_tensordict_keys_differ_by_more_than_a_plural():
    values = {value for name, value in vars(keys).items() if name.isupper()}
    assert not {value for value in values if f"{value}s" in values}
