"""How this project compiles its numeric kernels; all that touches Numba's inside."""
