"""Keeps every library to one thread, where this is imported before NumPy, Numba and PyTorch are."""

import os

for library in ("OMP_NUM", "OPENBLAS_NUM", "MKL_NUM", "NUMBA_NUM", "VECLIB_MAXIMUM"):
    os.environ[f"{library}_THREADS"] = "1"
