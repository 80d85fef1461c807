"""Checks of optional dependencies and hints for their installation."""

from __future__ import annotations

from importlib.util import find_spec


def install_hint(extra: str) -> str:
    """Return the command that installs an extra of pyproject.toml in a clone."""
    return f"pip install -e '.[{extra}]' in a clone of navrl"


def require(extra: str, purpose: str, *modules: str) -> None:
    """Check that the modules of an extra are installed.

    Args:
        extra: Name of the extra in pyproject.toml.
        purpose: Feature that needs them, the subject of the error.
        modules: Top-level modules.

    Raises:
        ModuleNotFoundError: If a module is missing; the message lists all missing ones.
    """
    missing = [name for name in modules if find_spec(name) is None]
    if missing:
        hint = install_hint(extra)
        raise ModuleNotFoundError(f"{purpose}: needs {', '.join(missing)}; {hint}", name=missing[0])
