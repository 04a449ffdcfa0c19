"""Threefry by its published vectors, the same in every backend, and normal numbers by their statistics."""

import numba
import numpy as np
import pytest
import scipy.stats
import torch

from bicycle_env.backends.compiled import NUMBA, entry_point
from bicycle_env.backends.single_precision import NUMBA_FLOAT32
from bicycle_env.physics.elementary import NUMPY, PYTHON, array_namespace
from bicycle_env.physics.random_bits import MOST_DEVIATIONS, normal, normal_quantile, random_bits, threefry

# Random123's known answers (kat_vectors): threefry2x32, 20 rounds: counter, key, bits
KNOWN = [
    ((0x00000000, 0x00000000), (0x00000000, 0x00000000), (0x6B200159, 0x99BA4EFE)),
    ((0xFFFFFFFF, 0xFFFFFFFF), (0xFFFFFFFF, 0xFFFFFFFF), (0x1CB996FC, 0xBB002BE7)),
    ((0x243F6A88, 0x85A308D3), (0x13198A2E, 0x03707344), (0xC4923A9C, 0x483DF7A0)),
]


@pytest.mark.parametrize(("counter", "key", "expected"), KNOWN)
def test_the_published_vectors(counter, key, expected):
    assert threefry(PYTHON)(*key, *counter) == expected
    columns = [np.array([value, value], dtype=np.int64) for value in (*key, *counter)]
    assert [bits.tolist() for bits in threefry(NUMPY)(*columns)] == [[value] * 2 for value in expected]
    tensors = threefry(array_namespace(torch))(*map(torch.from_numpy, columns))
    assert [bits.tolist() for bits in tensors] == [[value] * 2 for value in expected]


def columns_of(count, seed=0):
    return tuple(np.floor(65536.0 * column) for column in np.random.default_rng(seed).random((4, count)))


def compiled(xp, kind):
    law = xp.function(normal(xp))

    def run(key, steps, channel, out):
        for k in range(len(out)):
            out[k] = law((key[0, k], key[1, k], key[2, k], key[3, k]), steps[k], channel)

    return entry_point(run, numba.void(kind[:, ::1], kind[::1], numba.int64, kind[::1]))


def test_all_backends_give_the_same_numbers():
    keys, steps = columns_of(300), np.arange(300.0)
    expected = normal(NUMPY)(keys, steps, 7)
    python = normal(PYTHON)
    assert [python(tuple(column[k] for column in keys), steps[k], 7) for k in range(300)] == expected.tolist()
    tensors = normal(array_namespace(torch))(tuple(map(torch.from_numpy, keys)), torch.from_numpy(steps), 7)
    np.testing.assert_allclose(tensors.numpy(), expected, rtol=1e-15)
    for xp, kind, near in ((NUMBA, numba.float64, 1e-15), (NUMBA_FLOAT32, numba.float32, 1e-6)):
        dtype = np.dtype(str(kind))
        out = np.empty(300, dtype)
        compiled(xp, kind)(np.array(keys, dtype=dtype), steps.astype(dtype), 7, out)
        np.testing.assert_allclose(out, expected, rtol=near, atol=near)


def test_the_numbers_are_normal():
    count = 400_000
    found = normal(NUMPY)(columns_of(count), np.arange(count) % 400.0, 3)
    assert abs(np.mean(found)) < 4.0 / np.sqrt(count)
    assert abs(np.var(found) - 1.0) < 4.0 * np.sqrt(2.0 / count)
    assert abs(scipy.stats.kurtosis(found)) < 4.0 * np.sqrt(24.0 / count)
    assert scipy.stats.kstest(found, "norm").pvalue > 0.001
    assert 4.0 < np.max(np.abs(found)) < 5.6


def test_steps_channels_and_keys_are_independent():
    steps = np.arange(20_000.0)
    key = tuple(np.full(20_000, value) for value in (1.0, 2.0, 3.0, 4.0))
    other = (key[0] + 1.0, *key[1:])
    draw = normal(NUMPY)
    rows = [draw(key, steps, 0), draw(key, steps + 1.0, 0), draw(key, steps, 1), draw(other, steps, 0)]
    correlations = np.corrcoef(rows) - np.eye(4)
    assert np.max(np.abs(correlations)) < 4.5 / np.sqrt(len(steps))
    bits = random_bits(PYTHON)
    seen = {bits((1.0, 2.0, 3.0, 4.0), float(step), channel) for step in range(50) for channel in range(20)}
    assert len(seen) == 1000


def test_the_quantiles_are_the_normal_distributions():
    end = scipy.stats.norm.cdf(MOST_DEVIATIONS)
    shares = np.linspace(1.0 - end, end, 100_001)
    found = normal_quantile(NUMPY)(shares)
    assert (np.diff(found) > 0.0).all()
    assert np.abs(found - scipy.stats.norm.ppf(shares)).max() < 6e-4
    assert np.abs(scipy.stats.norm.cdf(found) - shares).max() < 2e-5
