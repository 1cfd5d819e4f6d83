"""The vector type of compiled code, which reaches into Numba."""

from __future__ import annotations

import numba
import numpy as np
import pytest


def test_numba_still_has_what_the_vector_type_uses_of_it():
    try:
        from amusic_gym.kernels import lanes

        @numba.njit
        def work(numbers, out):
            eight, sixteen = lanes.load(numbers, 1), lanes.spread(numbers, 4)
            product = lanes.multiply(lanes.add(eight, lanes.zeros()), sixteen)
            lanes.store(out, 0, lanes.multiply_add(eight, sixteen, product))
            lanes.store(out, lanes.LANES, lanes.greater(eight, sixteen))
            return lanes.largest(eight)

        numbers, out = np.arange(9, dtype=np.float32), np.zeros(16, np.float32)
        largest = work(numbers, out)
    except Exception as error:
        pytest.fail(
            f"Numba {numba.__version__} changed what amusic_gym/kernels/lanes.py uses of it "
            f"({error}); mend that file, or allow only older releases in pyproject.toml"
        )
    assert largest == 8
    assert out[:8].tolist() == [8 * number for number in range(1, 9)]
    assert out[8:].tolist() == [4, 4, 4, 4, 5, 6, 7, 8]
