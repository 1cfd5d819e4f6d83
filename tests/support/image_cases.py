"""Small pictures, encoded in every kind of file."""

from __future__ import annotations

import io

import cv2
import numpy as np
from PIL import Image as Pillow


def picture(height: int = 12, width: int = 16, seed: int = 0) -> np.ndarray:
    """A smooth colour picture, which compression hardly changes."""
    coarse = np.random.default_rng(seed).integers(0, 256, (3, 4, 3), dtype=np.uint8)
    return cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR)


def encoded(suffix: str, *options: int, image: np.ndarray | None = None) -> bytes:
    return cv2.imencode(suffix, picture() if image is None else image, options)[1].tobytes()


def pillow(kind: str, mode: str = "RGB", **options) -> bytes:
    file = io.BytesIO()
    Pillow.fromarray(picture()[..., ::-1]).convert(mode).save(file, kind, **options)
    return file.getvalue()


FILES = {
    "baseline JPEG": encoded(".jpg"),
    "progressive JPEG": encoded(".jpg", cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
    "JPEG with restart markers": encoded(".jpg", cv2.IMWRITE_JPEG_RST_INTERVAL, 1),
    "grey JPEG": pillow("JPEG", "L"),
    "CMYK JPEG": pillow("JPEG", "CMYK"),
    "PNG": encoded(".png"),
    "palette PNG": pillow("PNG", "P"),
    "one-bit PNG": pillow("PNG", "1"),
    "16-bit PNG": encoded(".png", image=picture().astype(np.uint16) * 257),
    "BMP": encoded(".bmp"),
    "palette BMP": pillow("BMP", "P"),
    "PPM": encoded(".ppm"),
    "PGM with a comment": b"P5 # a comment with 7 numbers\n#\n 16\t12\n255\n" + bytes(16 * 12),
    "PBM": pillow("PPM", "1"),
    "TIFF": encoded(".tif"),
    "big-endian TIFF": pillow("TIFF", big_endian=True),
    "16-bit TIFF": encoded(".tif", image=picture().astype(np.uint16) * 257),
    "lossy WebP": pillow("WEBP", quality=90),
    "lossless WebP": pillow("WEBP", lossless=True),
    "WebP with alpha": pillow("WEBP", "RGBA", exif=Pillow.Exif(), lossless=True),
}
