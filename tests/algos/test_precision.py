"""What ``precision=auto`` stands for, and what the contexts do."""

import pytest
import torch

from navrl.algos.precision import Precision, choose_precision

CPU = torch.device("cpu")


@pytest.mark.parametrize(
    ("found", "chosen"),
    [
        ({"avx2": True, "avx512_f": True, "avx512_bf16": False, "amx_bf16": False}, "float32"),
        ({"avx512_f": True, "avx512_bf16": True}, "bfloat16"),
        ({"amx_bf16": True}, "bfloat16"),
        ({"neon": True, "bf16": True}, "bfloat16"),
        ({"neon": True}, "float32"),
    ],
)
def test_bfloat16_requires_cpu_instructions(monkeypatch, found, chosen):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: found)
    monkeypatch.setattr(torch.backends.mkldnn, "is_available", lambda: True)
    assert choose_precision(CPU) == Precision("auto", CPU).name == chosen
    monkeypatch.setattr(torch.backends.mkldnn, "is_available", lambda: False)
    assert choose_precision(CPU) == "float32"


def test_gpu_rounds_inputs_of_products():
    assert Precision("auto", torch.device("cuda")).name == "tfloat32"
    assert Precision("auto", torch.device("mps")).name == "float32"


@pytest.mark.parametrize(
    ("name", "dtype", "rounding"),
    [
        ("float32", torch.float32, "highest"),
        ("tfloat32", torch.float32, "high"),
        ("bfloat16", torch.bfloat16, "highest"),
    ],
)
def test_precision_contexts_set_and_restore_the_format(name, dtype, rounding):
    precision, square = Precision(name, CPU), torch.eye(2)
    with precision.rounding():
        assert torch.get_float32_matmul_precision() == rounding
        with precision.autocast():
            assert (square @ square).dtype == dtype
    assert torch.get_float32_matmul_precision() == "highest"
    assert (square @ square).dtype == torch.float32


def test_unknown_precision_is_rejected():
    with pytest.raises(ValueError, match=r"precision='half': must be one of auto, bfloat16"):
        Precision("half", CPU)
