"""Arrays of a ``.caffemodel``: the protocol buffer of a Caffe network, without Caffe."""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Of caffe.proto only what holds weights; `layers` is the older form of `layer`.
_SCHEMA = {
    "BlobShape": "repeated int64 dim 1",
    "BlobProto": "optional int32 num 1, optional int32 channels 2, optional int32 height 3, "
    "optional int32 width 4, repeated float data 5, optional BlobShape shape 7, "
    "repeated double double_data 8",
    "LayerParameter": "optional string name 1, repeated BlobProto blobs 7",
    "V1LayerParameter": "optional string name 4, repeated BlobProto blobs 6",
    "NetParameter": "repeated V1LayerParameter layers 2, repeated LayerParameter layer 100",
}
_PACKAGE = "amusic_gym_caffe"


def read_caffemodel(data: bytes) -> dict[str, NDArray[Any]]:
    """Weights and biases as ``layer.weight`` and ``layer.bias``.

    Raises:
        ValueError: for an array whose shape does not fit its values.
        google.protobuf.message.DecodeError: when the bytes are no such protocol buffer.
    """
    network = _network().FromString(data)
    return {
        f"{layer.name}.{part}": _array(blob)
        for layer in (*network.layers, *network.layer)
        for part, blob in zip(("weight", "bias"), layer.blobs, strict=False)
    }


def _array(blob: Any) -> NDArray[Any]:
    values = np.array(blob.data, "<f4")
    if blob.double_data:
        values = np.concatenate([values, np.array(blob.double_data, "<f8")])
    if blob.HasField("shape"):
        return values.reshape(list(blob.shape.dim))
    sizes = (blob.num, blob.channels, blob.height, blob.width)  # absent ones are 0
    return values.reshape([size or 1 for size in sizes])


@cache
def _network() -> Any:
    """The class of the network's message."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    file = descriptor_pb2.FileDescriptorProto(name=f"{_PACKAGE}.proto", package=_PACKAGE)
    for message, described in _SCHEMA.items():
        made = file.message_type.add(name=message)
        for text in described.split(", "):
            label, kind, name, number = text.split()
            field = made.field.add(name=name, number=int(number), label=f"LABEL_{label.upper()}")
            if kind in _SCHEMA:
                field.type_name = f".{_PACKAGE}.{kind}"
            else:
                field.type = f"TYPE_{kind.upper()}"
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{_PACKAGE}.NetParameter"))
