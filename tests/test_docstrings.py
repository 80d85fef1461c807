"""Examples in docstrings run; public transforms, ops, metrics and network streams have one."""

import doctest
import inspect
import pkgutil
from importlib import import_module
from pathlib import Path

import pytest

import navrl
import navrl.evaluation.metrics
import navrl.networks
import navrl.ops
import navrl.transforms

ROOT = Path(navrl.__file__).parent
WITH_EXAMPLES = sorted(
    ".".join(("navrl", *file.relative_to(ROOT).with_suffix("").parts)).removesuffix(".__init__")
    for file in ROOT.rglob("*.py")
    if ">>> " in file.read_text()
)
ARGUMENT_CHECKS = ("check_", "missing_for_")  # raise or report only


def public_objects() -> dict[str, object]:
    found = {
        f"transforms.{name}": getattr(navrl.transforms, name) for name in navrl.transforms.__all__
    }
    metrics = navrl.evaluation.metrics
    found |= {f"metrics.{name}": getattr(metrics, name) for name in metrics.__all__}
    found |= {f"metrics.{row.name}": row.function for row in metrics.METRICS}
    streams = {name: getattr(navrl.networks, name) for name in navrl.networks.__all__}
    found |= {
        f"networks.{name}": item
        for name, item in streams.items()
        if inspect.isclass(item) and hasattr(item, "has_attention")
    }
    for info in pkgutil.iter_modules(navrl.ops.__path__, "navrl.ops."):
        if info.ispkg:  # kernels are internal
            continue
        module = import_module(info.name)
        for name, item in vars(module).items():
            is_own = getattr(item, "__module__", None) == info.name and not name.startswith("_")
            if is_own and callable(item) and not inspect.isclass(item):
                found[f"{info.name.removeprefix('navrl.')}.{name}"] = item
    return {name: item for name, item in found.items() if callable(item)}


@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_docstring_examples_run(name):
    result = doctest.testmod(import_module(name))
    assert result.attempted > 0
    assert result.failed == 0


@pytest.mark.parametrize("name", sorted(public_objects()))
def test_public_object_has_an_example(name):
    if name.rpartition(".")[2].startswith(ARGUMENT_CHECKS):
        pytest.skip("checks arguments only")
    assert ">>> " in inspect.getdoc(public_objects()[name])
