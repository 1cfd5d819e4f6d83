"""The protocol of a visual place recognition technique: describe images, match descriptors."""

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Image: TypeAlias = NDArray[np.uint8]
"""(height, width, 3) uint8, blue-green-red, as OpenCV and :mod:`amusic_gym.routes.images` give."""

Descriptor: TypeAlias = NDArray[np.float32]
"""float32, finite; of one technique all references' have one shape, and all queries' have one."""

Parameters: TypeAlias = Mapping[str, str | int | float | bool]


class Technique:
    """Base class of all techniques; one of your own needs ``name`` and :meth:`describe`.

    A technique holds no state that calls change: the same image gives the same bits in any order,
    in any process. It pickles by its arguments or whole.

    Attributes:
        name: what tables call it.
        batch: how many images :meth:`describe_batch` is best given; more than 1 pays on a GPU.
    """

    name: str
    batch: int = 1

    def parameters(self) -> Parameters:
        """All that the scores depend on besides the code: settings, digest of the weights.

        They are part of the key under which descriptors are cached.
        """
        return {}

    def describe(self, image: Image) -> Descriptor:
        """Descriptor of an image, as the map holds it.

        Raises:
            ValueError: for an array that is no image.
        """
        raise NotImplementedError(f"{type(self).__name__} must define describe(image)")

    def describe_batch(self, images: Sequence[Image]) -> list[Descriptor]:
        """Descriptors of several images, as :meth:`describe` gives them one by one."""
        return [self.describe(image) for image in images]

    def describe_query(self, image: Image) -> Descriptor:
        """Descriptor of a query image, where it is another than the map's."""
        return self.describe(image)

    def match(self, query: Descriptor, references: Descriptor) -> NDArray[np.float32]:
        """Similarity of a query to each of B references; higher is more similar.

        By default the dot product, which for descriptors of length 1 is the cosine.

        Args:
            query: what :meth:`describe_query` gave.
            references: (B, ...) what :meth:`describe` gave, stacked.

        Returns:
            (B,) float32. A reference's score does not depend on the others in ``references``,
            but for the last bits: those may differ between blocks of different B.
        """
        scores: NDArray[np.float32] = references.reshape(len(references), -1) @ query.ravel()
        return scores
