"""VGG16 and AlexNet from files of ImageNet weights, as R-MAC's authors and ``cirtorch`` use them.

==========================================  =======================  ==========================
file                                        known by                 feature map
==========================================  =======================  ==========================
``imagenet-vgg-verydeep-16.mat``            ``layers``, number 28    after pool5, 512 channels
``imagenet-caffe-alex.mat``                 ``layers``, number 12    after pool5, 256 channels
``imagenet-caffe-vgg16-features-….pth``,    ``28.weight``            conv5_3 after ReLU, 512
torchvision's ``vgg16-….pth``
==========================================  =======================  ==========================
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from amusic_gym.techniques.netvlad_weights import (
    VGG16_LAYERS,
    matlab_convolutions,
    matlab_layer,
    matlab_mean,
)
from amusic_gym.techniques.networks import conv_layers, load_layers
from amusic_gym.techniques.preparation import Preparation, Triple, check_image
from amusic_gym.techniques.protocol import Image
from amusic_gym.techniques.weight_files import WeightFile

LEAST = 96  # pixels of a side: smaller ones are enlarged, or pooling would leave nothing
_FIRST_VGG16 = "layers.28.weights.0"
_FIRST_ALEXNET = "layers.12.weights.0"


@dataclass(frozen=True)
class Backbone:
    """A convolutional network and the colours it expects."""

    layers: nn.Module  # (B, 3, H, W) -> (B, C, h, w), none below 0
    channels: int  # C
    mean: Triple  # of red, green and blue in 0–255; is subtracted
    deviation: Triple  # of red, green and blue in 0–255; divides

    def features(self, image: Image) -> Tensor:
        """Feature map (1, C, h, w) of an image in its own size; refuses what is no image."""
        check_image(image)
        height, width = (max(n, LEAST) for n in image.shape[:2])
        prepared = Preparation(width, height, self.mean, self.deviation, "linear").apply(image)
        with torch.inference_mode():
            found: Tensor = self.layers(torch.from_numpy(prepared)[None])
        return found


def load_backbone(file: WeightFile) -> Backbone:
    """VGG16 or AlexNet with a file's weights; refuses the first layer that does not fit."""
    plain = (1.0, 1.0, 1.0)
    part = file.under(_FIRST_VGG16)
    if part is not None:
        return _vgg16(matlab_convolutions(part), matlab_mean(part), plain, pool=True)
    part = file.under(_FIRST_ALEXNET)
    if part is not None:
        return _alexnet(matlab_convolutions(part), matlab_mean(part))
    part = file.under("28.weight")
    if part is None:
        raise ValueError(
            f"{file.missing('R-MAC', '28.weight')} (or {_FIRST_VGG16}, {_FIRST_ALEXNET})"
        )
    return _vgg16(part, Preparation.mean, Preparation.deviation, pool=False)


def _vgg16(file: WeightFile, mean: Triple, deviation: Triple, *, pool: bool) -> Backbone:
    """VGG16; ``pool``: with the pooling after its last ReLU."""
    layer = partial(_matlab_layer, file) if pool else partial(file.layer, "R-MAC")
    stages = tuple(
        tuple(len(layer(f"{number}.weight", None, None, 3, 3)) for number in stage)
        for stage in VGG16_LAYERS
    )
    network = load_layers(partial(conv_layers, stages), layer)
    network.append(nn.ReLU())
    if pool:
        network.append(nn.MaxPool2d(2))
    return Backbone(network, stages[-1][-1], mean, deviation)


def _alexnet(file: WeightFile, mean: Triple) -> Backbone:
    """Caffe's AlexNet up to pool5, its layers numbered as MatConvNet's."""
    widths = [3]
    layer = partial(_matlab_layer, file)
    for number, size in ((0, 11), (4, 5), (8, 3), (10, 3), (12, 3)):
        widths.append(len(layer(f"{number}.weight", None, None, size, size)))
    norm, pool = partial(nn.LocalResponseNorm, 5, 1e-4, 0.75, 1.0), partial(nn.MaxPool2d, 3, 2)

    def build() -> nn.Sequential:
        return nn.Sequential(
            *(nn.Conv2d(3, widths[1], 11, 4), nn.ReLU(), norm(), pool()),
            *(nn.Conv2d(widths[1], widths[2], 5, padding=2, groups=2), nn.ReLU(), norm(), pool()),
            *(nn.Conv2d(widths[2], widths[3], 3, padding=1), nn.ReLU()),
            *(nn.Conv2d(widths[3], widths[4], 3, padding=1, groups=2), nn.ReLU()),
            *(nn.Conv2d(widths[4], widths[5], 3, padding=1, groups=2), nn.ReLU(), pool()),
        )

    return Backbone(load_layers(build, layer), widths[-1], mean, (1.0, 1.0, 1.0))


def _matlab_layer(file: WeightFile, name: str, *shape: int | None) -> NDArray[np.float32]:
    return file.layer("R-MAC", matlab_layer(name), *shape)
