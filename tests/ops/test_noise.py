"""Range noise: its distribution, and that it depends on (seed, step, beam) alone."""

import pytest
import torch

from navrl.ops.noise import add_range_noise, noise_table


def scans(num_worlds=64, num_beams=1440, seed=0):
    generator = torch.Generator().manual_seed(seed)
    ranges = (4.0 * torch.rand(num_worlds, num_beams, generator=generator)).clamp(max=3.5)
    counters = torch.randint(0, 2**32, (2, num_worlds), generator=generator)
    return ranges, counters[0], counters[1] % 150


@pytest.mark.parametrize("kind", ["gaussian", "uniform"])
@pytest.mark.parametrize("num_beams", [1, 2, 3, 4, 1437, 1440])
def test_kernel_equals_torch_bit_for_bit(kind, num_beams):
    ranges, seed, step = scans(num_beams=num_beams)
    table = noise_table(kind, 0.025)
    kernel, reference = (
        add_range_noise(ranges, seed, step, table, 3.5, backend) for backend in ("numba", "torch")
    )
    assert torch.equal(kernel, reference)
    assert not torch.equal(kernel, ranges)


@pytest.mark.parametrize("kind", ["gaussian", "uniform"])
def test_noise_has_its_distribution(kind):
    _, seed, step = scans(num_worlds=256)
    noise = add_range_noise(torch.full((256, 1440), 1.0), seed, step, noise_table(kind, 0.025), 3.5)
    noise = (noise.double() - 1.0) / 0.025
    assert noise.mean().abs() < 0.005
    if kind == "gaussian":
        assert noise.std() == pytest.approx(1.0, abs=0.005)
        assert noise.abs().gt(2).double().mean() == pytest.approx(0.0455, abs=0.002)
        assert noise.pow(4).mean() == pytest.approx(3.0, abs=0.06)
    else:
        assert noise.std() == pytest.approx(3**-0.5, abs=0.003)
        assert noise.abs().max() < 1.0 + 1e-5
    for lag in (1, 2, 3, 4, 5):  # neither along a scan nor from scan to scan
        assert (noise[:, lag:] * noise[:, :-lag]).mean().abs() < 0.01


def test_steps_and_seeds_are_independent():
    ranges = torch.ones(4, 1440)
    seed, step = torch.tensor([5, 5, 6, 5]), torch.tensor([0, 1, 0, 0])
    noise = add_range_noise(ranges, seed, step, noise_table("gaussian", 0.025), 3.5) - 1.0
    correlation = torch.corrcoef(noise)
    assert torch.equal(noise[0], noise[3])
    assert correlation[0, 1].abs() < 0.1
    assert correlation[0, 2].abs() < 0.1


def test_noise_does_not_depend_on_the_batch():
    ranges, seed, step = scans()
    table = noise_table("gaussian", 0.025)
    noisy = add_range_noise(ranges, seed, step, table, 3.5)
    order = torch.randperm(64)
    assert torch.equal(
        add_range_noise(ranges[order][:9], seed[order][:9], step[order][:9], table, 3.5),
        noisy[order][:9],
    )
    wider = torch.cat((ranges, ranges), dim=1)
    assert torch.equal(add_range_noise(wider, seed, step, table, 3.5)[:, :1440], noisy)


@pytest.mark.parametrize("backend", ["numba", "torch"])
def test_noise_preserves_hits_and_misses(backend):
    _, seed, step = scans()
    table = noise_table("gaussian", 0.025)
    for reach in (0.0, 0.001, 3.4995, 3.499999):
        noisy = add_range_noise(torch.full((64, 1440), reach), seed, step, table, 3.5, backend)
        assert noisy.min() >= 0.0
        assert noisy.max() <= 3.4991
    misses = torch.full((64, 1440), 3.5)
    assert torch.equal(add_range_noise(misses, seed, step, table, 3.5, backend), misses)


@pytest.mark.parametrize("backend", ["numba", "torch"])
def test_nan_is_preserved(backend):
    ranges, seed, step = scans()
    ranges[3, 7] = torch.nan
    noisy = add_range_noise(ranges, seed, step, noise_table("gaussian", 0.025), 3.5, backend)
    assert noisy.isnan().nonzero().tolist() == [[3, 7]]


def test_input_is_not_modified():
    ranges, seed, step = scans()
    before = ranges.clone()
    add_range_noise(ranges, seed, step, noise_table("gaussian", 0.025), 3.5)
    assert torch.equal(ranges, before)


def test_bad_input_is_named():
    ranges, seed, step = scans()
    table = noise_table("none", 0.0)
    with pytest.raises(ValueError, match="seed: must be"):
        add_range_noise(ranges, seed.float(), step, table, 3.5)
    with pytest.raises(ValueError, match="step: must be"):
        add_range_noise(ranges, seed, step[:3], table, 3.5)
    with pytest.raises(ValueError, match="ranges: must be"):
        add_range_noise(ranges.double(), seed, step, table, 3.5)
    with pytest.raises(ValueError, match="gaussian, uniform or none"):
        noise_table("normal", 0.1)
    with pytest.raises(ValueError, match="not negative"):
        noise_table("gaussian", -0.1)
