"""Rows of the compiled pipeline, without a compiler."""

import shutil

import pytest
import torch

import navrl
from navrl.benchmarks import Budget, compile_rows
from navrl.transforms import TAGD, ICPAlign, MinPool

BUDGET = Budget(seconds=1e-9, repeats=2)


@pytest.fixture(scope="module")
def env():
    return navrl.make(["scenario=corridor", "pool_size=2"], num_worlds=2)


def steps():
    return MinPool(8), ICPAlign(), TAGD()


def test_eager_and_compiled_do_the_same_work(env, monkeypatch):
    calls = []

    def compiled(form, fullgraph):
        assert fullgraph
        return lambda *inputs: calls.append(form(*inputs)) or calls[-1]

    monkeypatch.setattr(torch, "compile", compiled)
    monkeypatch.setattr(shutil, "which", lambda name: name)
    rows = compile_rows(env, steps(), BUDGET)
    assert [row.key for row in rows] == ["compile.eager", "compile.compiled", "compile.ratio"]
    assert [tuple(value.shape) for value in calls[0][:3]] == [(2, 180), (2, 180, 2), (2, 180)]
    assert all((row.values > 0).all() and len(row.values) == 2 for row in rows)


def test_missing_compiler_is_the_reason_for_no_rows(env, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    (reason,) = compile_rows(env, steps(), BUDGET)
    assert reason.startswith("compile: torch.compile needs a C++ compiler")
