"""NetVLAD: convolutional features, aggregated as residuals to visual words (Arandjelović 2016)."""

from pathlib import Path

import torch

from amusic_gym.techniques.netvlad_weights import load_netvlad
from amusic_gym.techniques.protocol import Descriptor, Image, Parameters, Technique
from amusic_gym.techniques.weight_files import read_weights, shipped


class NetVLAD(Technique):
    """NetVLAD; descriptors of length 1, cosine.

    With public weights: VGG16 up to conv5_3 on the image at 640×480, 64 visual words, whitening
    to 4096 values where the file has one. Without: a compact network of the same kind at the size
    its file states, which was trained for this package and is not the published one.

    No scores of this implementation were ever compared with published ones: the public weights
    were not at hand. Its layers are tested against an independent computation.

    Args:
        weights: hloc's ``Pitts30K_struct.mat``, a checkpoint of pytorch-NetVlad, one of
            Patch-NetVLAD with its whitening, OpenIBL's ``vgg16_netvlad.pth``, a network on VGG16
            of deep-vg-benchmark or OpenVPRLab (``.ckpt``), or the same arrays in another
            container that :func:`~amusic_gym.techniques.weight_files.read_weights` knows. None:
            the weights that ship.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: for a file that is damaged, or whose layers are not NetVLAD's.
    """

    name = "NetVLAD"

    def __init__(self, weights: str | Path | None = None) -> None:
        file = read_weights(shipped("netvlad") if weights is None else weights)
        self._digest = file.digest
        self._network, self._preparation = load_netvlad(file)

    def parameters(self) -> Parameters:
        """The digest of the weights' file, the input's size and the order of the residuals."""
        return {
            "weights": self._digest,
            "width": self._preparation.width,
            "height": self._preparation.height,
            "interpolation": self._preparation.interpolation,
            "descriptor_major": self._network.widths.descriptor_major,
        }

    def describe(self, image: Image) -> Descriptor:
        """(P,) of length 1, or (K·C,) with weights that have no whitening."""
        colours = torch.from_numpy(self._preparation.apply(image)).unsqueeze(0)  # (1, 3, H, W)
        with torch.inference_mode():
            descriptor: Descriptor = self._network(colours)[0].numpy()
        return descriptor
