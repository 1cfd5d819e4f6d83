"""The networks behind CALC and NetVLAD, as PyTorch modules. They learn, and describe, one image.

An encoder takes a batch of prepared images and gives descriptors; what prepares an image is in
:mod:`~amusic_gym.techniques.calc` and :mod:`~amusic_gym.techniques.netvlad`.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from typing import TypeAlias, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812 (its usual name)
from torch.nn.utils import fuse_conv_bn_eval

from amusic_gym.utils.checks import whole

Stages: TypeAlias = tuple[tuple[int, ...], ...]
Network = TypeVar("Network", bound=nn.Module)
COMPACT_STAGES: Stages = ((16, 16), (32, 32), (64, 64), (128, 128))  # small enough to ship
WIDEST = 65536  # largest size of a layer: a damaged file must not fill the memory


class CALCEncoder(nn.Module):
    """CALC's encoder (Merrill and Huang 2018, the network ``calc`` of their code).

    Pooling rounds sizes up (ceil mode), as Caffe does, and PyTorch's response normalisation
    divides alpha by the window's size, as Caffe's does too.
    """

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(1, 64, kernel_size=5, stride=2, padding=4)
        self.conv2 = nn.Conv2d(64, 128, kernel_size=4, padding=2)
        self.conv3 = nn.Conv2d(128, 4, kernel_size=3)
        self.pool = nn.MaxPool2d(kernel_size=3, stride=2, ceil_mode=True)
        self.norm = nn.LocalResponseNorm(size=5, alpha=1e-4, beta=0.75, k=1.0)

    def forward(self, images: Tensor) -> Tensor:
        """(B, 1, 120, 160) grey, 0 to 1 -> (B, 1064), none below 0, not yet of length 1."""
        first = self.norm(self.pool(torch.relu(self.conv1(images))))  # (B, 64, 31, 41)
        second = self.norm(self.pool(torch.relu(self.conv2(first))))  # (B, 128, 16, 21)
        return torch.relu(self.conv3(second)).flatten(1)  # (B, 4, 14, 19) -> (B, 1064)


@dataclass(frozen=True)
class NetVLADWidths:
    """Sizes of a NetVLAD network; the defaults are those of the compact variant.

    Raises:
        ValueError: for sizes that no network has.
    """

    stages: Stages = COMPACT_STAGES  # output channels of each convolution, by stage
    clusters: int = 16  # K, the number of visual words
    whitened: int | None = 256  # P, the length of the whitened descriptor; None: K·C values
    assignment_bias: bool = False  # of the soft assignment
    # how the residuals (K, C) are flattened, and the whitening's columns ordered: False: c + k·C,
    # as in PyTorch ports; True: k + c·K, as in the MATLAB original
    descriptor_major: bool = False

    def __post_init__(self) -> None:
        if not self.stages or not all(self.stages):
            raise ValueError(f"stages are {self.stages!r}; give channels for each stage")
        sizes = [*(width for stage in self.stages for width in stage), self.clusters]
        for size in sizes if self.whitened is None else [*sizes, self.whitened]:
            whole("a layer's size", size, 1, most=WIDEST)

    @property
    def channels(self) -> int:
        """C, the length of a local descriptor."""
        return self.stages[-1][-1]

    @property
    def flat(self) -> int:
        """K·C, the length of all residuals."""
        return self.clusters * self.channels


def conv_layers(stages: Stages, batch_norm: bool = False) -> nn.Sequential:
    """VGG-like backbone on RGB: 3×3 convolutions with ReLU, 2×2 max-pooling between stages.

    Without batch normalisation its layers are numbered as VGG16's in torchvision. The last
    convolution has no ReLU: NetVLAD aggregates conv5_3 as it is.
    """
    layers: list[nn.Module] = []
    width_in = 3
    for stage in stages:
        for width in stage:
            layers.append(nn.Conv2d(width_in, width, kernel_size=3, padding=1))
            if batch_norm:
                layers.append(nn.BatchNorm2d(width))
            layers.append(nn.ReLU())
            width_in = width
        layers.append(nn.MaxPool2d(kernel_size=2))
    return nn.Sequential(*layers[:-2])


class NetVLADPooling(nn.Module):
    """Residuals of local features to K visual words, softly assigned (Arandjelović 2016, eq. 4)."""

    def __init__(self, channels: int, clusters: int, bias: bool = False) -> None:
        super().__init__()
        self.assignment = nn.Linear(channels, clusters, bias=bias)  # logits
        centroids = torch.empty(clusters, channels)
        if not centroids.is_meta:  # there, it would import PyTorch's compiler, which takes seconds
            centroids = F.normalize(centroids.normal_(), dim=1)
        self.centroids = nn.Parameter(centroids)  # (K, C)

    def forward(self, features: Tensor) -> Tensor:
        """Residuals, of length 1 per word: (B, C, h, w) -> (B, K, C)."""
        local = F.normalize(features.flatten(2), dim=1).transpose(1, 2)  # (B, N, C)
        shares = torch.softmax(self.assignment(local), dim=2).transpose(1, 2)  # (B, K, N)
        sums = shares @ local - shares.sum(2, keepdim=True) * self.centroids  # (B, K, C)
        return F.normalize(sums, dim=2)


class NetVLADNetwork(nn.Module):
    """Backbone, NetVLAD pooling and whitening.

    Args:
        widths: sizes of the layers.
        batch_norm: for training only; :meth:`folded` takes it out again.
    """

    def __init__(
        self,
        widths: NetVLADWidths = NetVLADWidths(),
        batch_norm: bool = False,  # noqa: B008
    ) -> None:
        super().__init__()
        self.widths = widths
        self.backbone = conv_layers(widths.stages, batch_norm)
        self.pool = NetVLADPooling(widths.channels, widths.clusters, widths.assignment_bias)
        self.whitening = None
        if widths.whitened is not None:
            self.whitening = nn.Linear(widths.flat, widths.whitened)

    def aggregate(self, images: Tensor) -> Tensor:
        """Descriptors before the whitening, of length 1: (B, 3, H, W) -> (B, K·C)."""
        residuals = self.pool(self.backbone(images))  # (B, K, C)
        if self.widths.descriptor_major:
            residuals = residuals.transpose(1, 2)  # (B, C, K)
        return F.normalize(residuals.flatten(1), dim=1)

    def forward(self, images: Tensor) -> Tensor:
        """Descriptors (B, P) of length 1, or (B, K·C) without whitening, of images (B, 3, H, W).

        These are RGB, less the mean and divided by the deviation that belong to the weights.
        """
        flat = self.aggregate(images)
        if self.whitening is None:
            return flat
        return F.normalize(self.whitening(flat), dim=1)

    def folded(self) -> NetVLADNetwork:
        """A copy for use: batch normalisation merged into the convolutions before it."""
        copy = deepcopy(self).eval()
        layers: list[nn.Module] = []
        for layer in copy.backbone:
            if isinstance(layer, nn.BatchNorm2d):
                layers.append(fuse_conv_bn_eval(layers.pop(), layer))  # type: ignore[type-var]
            else:
                layers.append(layer)
        copy.backbone = nn.Sequential(*layers)
        return copy


def load_layers(build: Callable[[], Network], layer: Callable[..., NDArray[np.float32]]) -> Network:
    """A network with its weights, ready for use: no gradients, no training mode.

    ``layer`` gives a layer's weights by its name and shape.
    """
    with torch.device("meta"):  # no memory, no random numbers
        network = build()
    tensors = {
        name: torch.from_numpy(layer(name, *tensor.shape))
        for name, tensor in network.state_dict().items()
        if tensor.is_floating_point()
    }
    for name, tensor in network.state_dict().items():  # counters of batch normalisation
        tensors.setdefault(name, torch.zeros_like(tensor, device="cpu"))
    network.load_state_dict(tensors, assign=True)
    # Colour channels innermost: PyTorch pools several times faster then.
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return network.requires_grad_(False).eval()
