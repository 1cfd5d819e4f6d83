"""CALC and NetVLAD again, by loops and plain NumPy in float64: what the modules must give."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Weights = Mapping[str, NDArray[Any]]


def convolve(x: Floats, kernel: NDArray[Any], bias: NDArray[Any], pad: int, step: int) -> Floats:
    """(C, H, W) with (D, C, h, w) -> (D, H', W'); no flip, as networks call convolution."""
    padded = np.pad(x, ((0, 0), (pad, pad), (pad, pad)))
    windows = sliding_window_view(padded, kernel.shape[2:], axis=(1, 2))[:, ::step, ::step]
    return np.tensordot(kernel.astype(float), windows, ((1, 2, 3), (0, 3, 4))) + bias[:, None, None]


def pool_up(x: Floats, size: int, step: int) -> Floats:
    """Max-pooling whose last windows may hang over the edge (Caffe's rule of sizes)."""
    height, width = (int(np.ceil((n - size) / step)) + 1 for n in x.shape[1:])
    out = np.empty((len(x), height, width))
    for i in range(height):
        for j in range(width):
            window = x[:, i * step : i * step + size, j * step : j * step + size]
            out[:, i, j] = window.max(axis=(1, 2))
    return out


def normalise_response(x: Floats) -> Floats:
    """Across 5 channels: each value through (1 + 1e-4/5 · Σ squares)^0.75."""
    out = np.empty_like(x)
    for channel in range(len(x)):
        near = x[max(0, channel - 2) : channel + 3]
        out[channel] = x[channel] / (1 + 1e-4 / 5 * (near**2).sum(0)) ** 0.75
    return out


def calc_layers(grey: NDArray[Any], weights: Weights) -> list[Floats]:
    """Every layer's output for a (120, 160) image, the descriptor last."""

    def conv(x: Floats, name: str, pad: int, step: int) -> Floats:
        return convolve(x, weights[f"{name}.weight"], weights[f"{name}.bias"], pad, step)

    layers = [conv(grey.astype(float)[None], "conv1", 4, 2)]
    layers.append(normalise_response(pool_up(np.maximum(layers[-1], 0), 3, 2)))
    layers.append(conv(layers[-1], "conv2", 2, 1))
    layers.append(normalise_response(pool_up(np.maximum(layers[-1], 0), 3, 2)))
    layers.append(np.maximum(conv(layers[-1], "conv3", 0, 1), 0))
    return [*layers, unit(layers[-1].ravel())]


def unit(x: Floats) -> Floats:
    return x / np.linalg.norm(x)


def vgg16(x: Floats, weights: Weights) -> Floats:
    """conv1_1 … conv5_3 with the names ``encoder.N``; no ReLU after the last."""
    pools, last = (3, 8, 15, 22), 28  # numbers of the ReLUs before a pooling; the last layer
    for number in (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28):
        name = f"encoder.{number}"
        x = convolve(x, weights[f"{name}.weight"], weights[f"{name}.bias"], 1, 1)
        if number != last:
            x = np.maximum(x, 0)
        if number + 1 in pools:
            c, h, w = x.shape
            x = x[:, : h // 2 * 2, : w // 2 * 2].reshape(c, h // 2, 2, w // 2, 2).max((2, 4))
    return x


def vlad(features: Floats, weights: Weights) -> Floats:
    """Residuals (K, C), each of length 1, summed location by location."""
    centres = weights["pool.centroids"].astype(float)
    matrix = weights["pool.conv.weight"][:, :, 0, 0].astype(float)
    bias = weights.get("pool.conv.bias", np.zeros(len(centres)))
    sums = np.zeros_like(centres)
    for local in features.reshape(len(features), -1).T:
        local = local / np.linalg.norm(local)
        logits = matrix @ local + bias
        shares = np.exp(logits - logits.max())
        shares /= shares.sum()
        for k, centre in enumerate(centres):
            sums[k] += shares[k] * (local - centre)
    return sums / np.linalg.norm(sums, axis=1, keepdims=True)


def netvlad(x: NDArray[Any], weights: Weights, descriptor_major: bool) -> Floats:
    """Descriptor of a prepared image (3, H, W), whitened where there is a whitening."""
    residuals = vlad(vgg16(x.astype(float), weights), weights)
    flat = []
    if descriptor_major:
        for c in range(residuals.shape[1]):
            flat += [residuals[k, c] for k in range(len(residuals))]
    else:
        for k in range(len(residuals)):
            flat += list(residuals[k])
    descriptor = unit(np.array(flat))
    if "WPCA.0.weight" in weights:
        matrix = weights["WPCA.0.weight"][:, :, 0, 0].astype(float)
        descriptor = unit(matrix @ descriptor + weights["WPCA.0.bias"])
    return descriptor
