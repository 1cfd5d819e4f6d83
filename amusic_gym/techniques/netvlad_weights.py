"""NetVLAD's weights from files of several families, each with its own names, order and input.

================================  ==========================================  ================
family                            known by                                    flattened
================================  ==========================================  ================
ours (``save_netvlad``)           the metadata                                as the file says
MATLAB (``Pitts30K_struct.mat``)  ``net.layers`` with NetVLAD as number 30    c·K + k
PyTorch (``.pth.tar``,            ``pool.centroids``, ``pool.conv.weight``,   k·C + c
Patch-NetVLAD)                    ``encoder.N``; maybe ``WPCA.0``
OpenIBL                           ``net_vlad``, ``base_model.base.N``;        k·C + c
                                  maybe ``pca_layer``
deep-vg-benchmark, OpenVPRLab     ``aggregation`` (or ``aggregation.0``, with k·C + c
(``.pth``, ``.ckpt``)             the layer ``aggregation.2``; ``aggregator``
                                  in new files), ``backbone.N``
================================  ==========================================  ================

The whitening's columns are in the family's order, so an order goes with its whitening only.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.techniques.networks import NetVLADNetwork, NetVLADWidths, load_layers
from amusic_gym.techniques.preparation import Preparation
from amusic_gym.techniques.weight_files import WeightFile
from amusic_gym.techniques.weight_readers import Arrays

VGG16_LAYERS = ((0, 2), (5, 7), (10, 12, 14), (17, 19, 21), (24, 26, 28))
"""Numbers of VGG16's convolutions, by stage, in all families."""

MATLAB_ANCHOR = "layers.30.weights.0"
MATLAB_MEAN = "meta.normalization.averageImage"
MATLAB_NAMES = {
    "pool.assignment.weight": "layers.30.weights.0",
    "pool.centroids": "layers.30.weights.1",
    "whitening.weight": "layers.33.weights.0",
    "whitening.bias": "layers.33.weights.1",
}
PUBLIC_INPUT = Preparation(width=640, height=480, interpolation="cubic")
"""Input for public weights; mean and deviation are ImageNet's, the family's, or the file's."""

OPENIBL_COLOURS = ((123.68, 116.779, 103.939), (1.0, 1.0, 1.0))  # mean, deviation

PYTORCH = (
    ("pool", "encoder", "WPCA.0"),
    ("net_vlad", "base_model.base", "pca_layer"),
    ("aggregation.0", "backbone", "aggregation.2"),
    ("aggregation", "backbone", ""),
    ("aggregator", "backbone", ""),
)
"""Names in PyTorch's families: NetVLAD's layer, VGG16 and the whitening, where there is one."""


@dataclass(frozen=True)
class _Family:
    """How one family's file is read."""

    file: WeightFile  # its arrays, in the shapes of our modules
    name: Callable[[str], str]  # our layer's name -> the file's
    descriptor_major: bool  # the order of flattening
    preparation: Preparation  # what its input is


def load_netvlad(file: WeightFile) -> tuple[NetVLADNetwork, Preparation]:
    """The network with a file's weights, and its preparation; refuses layers that do not fit."""
    described = file.description("NetVLAD")
    if described is not None:
        widths, preparation = _read_description(file, described)
        return _build(file, widths, str), preparation
    family = _matlab(file) or _pytorch(file)
    if family is None:
        first, *others = [f"{pool}.centroids" for pool, *_ in PYTORCH]
        raise ValueError(f"{file.missing('NetVLAD', first)} (or {', '.join(others)})")
    return _build(family.file, _widths_of(family), family.name), family.preparation


def _build(file: WeightFile, widths: NetVLADWidths, name: Callable[[str], str]) -> NetVLADNetwork:
    def layer(ours: str, *shape: int) -> NDArray[np.float32]:
        return file.layer("NetVLAD", name(ours), *shape)

    return load_layers(partial(NetVLADNetwork, widths), layer)


def _read_description(
    file: WeightFile, described: dict[str, Any]
) -> tuple[NetVLADWidths, Preparation]:
    try:
        given = dict(described["widths"])
        stages = tuple(tuple(stage) for stage in given.pop("stages"))
        fields = dict(described["preparation"])
        fields |= {name: tuple(fields[name]) for name in ("mean", "deviation")}
        return NetVLADWidths(stages=stages, **given), Preparation(**fields)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"the metadata of {file.path} is damaged ({error}); copy the file again"
        ) from None


def _widths_of(family: _Family) -> NetVLADWidths:
    """Sizes of the layers, from the arrays."""

    def rows(ours: str, *shape: int | None) -> int:
        return len(family.file.layer("NetVLAD", family.name(ours), None, *shape))

    stages = tuple(
        tuple(rows(f"backbone.{number}.weight", None, 3, 3) for number in stage)
        for stage in VGG16_LAYERS
    )
    clusters = rows("pool.centroids", stages[-1][-1])
    whitened = family.name("whitening.weight") in family.file.arrays
    return NetVLADWidths(
        stages=stages,
        clusters=clusters,
        whitened=rows("whitening.weight", clusters * stages[-1][-1]) if whitened else None,
        assignment_bias=family.name("pool.assignment.bias") in family.file.arrays,
        descriptor_major=family.descriptor_major,
    )


def _matlab(file: WeightFile) -> _Family | None:
    """MatConvNet's layers: height, width, in, out; centres with the opposite sign."""
    part = file.under(MATLAB_ANCHOR)
    if part is None:
        return None
    shaped = matlab_convolutions(part).arrays
    for name in {"layers.30.weights.0", "layers.33.weights.0"} & set(shaped):
        array = part.arrays[name]
        shaped[name] = array.reshape(-1, array.shape[-1]).T  # (1, 1, in, out) -> (out, in)
    if (centres := shaped.get("layers.30.weights.1")) is not None:
        shaped["layers.30.weights.1"] = -centres.reshape(-1, centres.shape[-1]).T  # (K, C)
    mean = matlab_mean(part)
    return _Family(
        file=replace(part, arrays=shaped),
        name=_matlab_name,
        descriptor_major=True,
        preparation=replace(PUBLIC_INPUT, mean=mean, deviation=(1.0, 1.0, 1.0)),
    )


def _matlab_name(ours: str) -> str:
    if not ours.startswith("backbone"):
        return MATLAB_NAMES.get(ours, ours)
    return matlab_layer(ours.removeprefix("backbone."))


def matlab_layer(name: str) -> str:
    """MatConvNet's name of a layer's weights or bias: ``28.weight`` -> ``layers.28.weights.0``."""
    number, part = name.split(".")
    return f"layers.{number}.weights.{'0' if part == 'weight' else '1'}"


def matlab_convolutions(file: WeightFile) -> WeightFile:
    """MatConvNet's weights (h, w, in, out) as (out, in, h, w), and its biases; nothing else."""
    shaped: Arrays = {}
    for name, array in file.arrays.items():
        if name.endswith("weights.0"):
            shaped[name] = array.transpose(3, 2, 0, 1) if array.ndim == 4 else array
        elif name.endswith("weights.1"):
            shaped[name] = array
    return replace(file, arrays=shaped)


def matlab_mean(file: WeightFile) -> tuple[float, float, float]:
    """Mean colour: the first pixel of the average image, which has one colour throughout."""
    image = file.arrays.get(MATLAB_MEAN, np.empty(0))
    if image.size == 0 or image.size % 3 or not np.isfinite(image).all():
        raise ValueError(
            f"{file.path} has no mean colour ({MATLAB_MEAN} has shape {image.shape}), which "
            "is subtracted from images; download it again"
        )
    red, green, blue = (float(value) for value in image.reshape(-1, 3)[0])
    return red, green, blue


def _pytorch(file: WeightFile) -> _Family | None:
    """State dictionaries: :data:`PYTORCH`."""
    for pool, backbone, whitening in PYTORCH:
        part = file.under(f"{pool}.centroids")
        if part is None:
            continue
        names = {
            "pool.assignment": f"{pool}.conv",
            "pool.centroids": f"{pool}.centroids",
            "whitening": whitening,
            "backbone": backbone,
        }

        def named(ours: str, names: dict[str, str] = names) -> str:
            found = next(start for start in names if ours.startswith(start))
            return names[found] + ours.removeprefix(found)

        arrays = {name: _without_pixels(array) for name, array in part.arrays.items()}
        preparation = PUBLIC_INPUT
        if pool == "net_vlad":
            mean, deviation = OPENIBL_COLOURS
            preparation = replace(preparation, mean=mean, deviation=deviation)
        return _Family(replace(part, arrays=arrays), named, False, preparation)
    return None


def _without_pixels(array: NDArray[Any]) -> NDArray[Any]:
    """A 1×1 convolution's weights as a matrix, (out, in, 1, 1) -> (out, in)."""
    return array[:, :, 0, 0] if array.ndim == 4 and array.shape[2:] == (1, 1) else array
