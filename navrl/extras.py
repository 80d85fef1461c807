"""Optional dependencies: what to install for a feature that needs more than the base."""

from __future__ import annotations

from importlib.util import find_spec


def install_hint(extra: str) -> str:
    """Return the command that installs an extra of pyproject.toml, to be run in a clone."""
    return f"pip install -e '.[{extra}]' in a clone of navrl"


def require(extra: str, purpose: str, *modules: str) -> None:
    """Raise unless the modules of an extra are installed.

    Args:
        extra: Its name in pyproject.toml.
        purpose: What needs them, the subject of the error.
        modules: Top-level modules.

    Raises:
        ModuleNotFoundError: If one is missing, naming all that are.
    """
    missing = [name for name in modules if find_spec(name) is None]
    if missing:
        hint = install_hint(extra)
        raise ModuleNotFoundError(f"{purpose}: needs {', '.join(missing)}; {hint}", name=missing[0])
