"""``python -m amusic_gym.worlds --out FILE.jpg`` draws the contact sheets of the docs."""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2

from amusic_gym.worlds.sheet import contact_sheet, image_condition_sheet


def main() -> None:
    """Draw and write it."""
    parser = argparse.ArgumentParser(description="contact sheet of all conditions")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.jpg")
    parser.add_argument(
        "--on-images", action="store_true", help="of the conditions that are put on any image"
    )
    args = parser.parse_args()
    sheet = image_condition_sheet() if args.on_images else contact_sheet()
    good, data = cv2.imencode(".jpg", sheet, [cv2.IMWRITE_JPEG_QUALITY, 62])
    if not good:
        raise RuntimeError("OpenCV cannot encode the sheet as JPEG")
    args.out.write_bytes(data.tobytes())


if __name__ == "__main__":
    main()
