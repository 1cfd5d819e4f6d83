"""``python -m amusic_gym.routes.rendered --out FILE.jpg`` draws the contact sheet of the docs."""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2

from amusic_gym.routes.rendered.sheet import contact_sheet


def main() -> None:
    """Draw and write it."""
    parser = argparse.ArgumentParser(description="contact sheet of all conditions")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.jpg")
    out = parser.parse_args().out
    good, data = cv2.imencode(".jpg", contact_sheet(), [cv2.IMWRITE_JPEG_QUALITY, 62])
    if not good:
        raise RuntimeError("OpenCV cannot encode the sheet as JPEG")
    out.write_bytes(data.tobytes())


if __name__ == "__main__":
    main()
