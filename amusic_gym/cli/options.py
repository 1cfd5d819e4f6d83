"""Options that several commands take, each described once."""

from pathlib import Path
from typing import Any

from amusic_gym.techniques import TECHNIQUES

MANY: dict[str, Any] = {"nargs": "+", "action": "extend", "default": []}
"""Of an option that takes several values and may be repeated."""

SHARED: dict[str, dict[str, Any]] = {
    "--bank": {**MANY, "metavar": "BANK", "help": "folders of score banks"},
    "--cache": {
        "type": Path,
        "metavar": "DIR",
        "help": "where descriptors are kept (default: $XDG_CACHE_HOME or ~/.cache, amusic-gym)",
    },
    "--compute-weight": {
        "nargs": "+",
        "type": float,
        "metavar": "L",
        "help": "λ (default: %(default)s)",
    },
    "--costs": {"help": "cost model (default: the bank's own)"},
    "--device": {
        "default": "cpu",
        "metavar": "cpu|cuda",
        "help": "where torchscript:, onnx: and hub: run (default: %(default)s)",
    },
    "--every": {"type": int, "metavar": "N", "help": "of a video: take each N-th frame"},
    "--every-metres": {
        "type": float,
        "metavar": "M",
        "help": "take the first image, and each next one at least M metres on; needs positions",
    },
    "--exclude-recent": {
        "type": int,
        "metavar": "N",
        "help": "one sequence against itself (loop closure): the N frames before each, itself and"
        " those after it are no candidates",
    },
    "--executor": {
        "default": "serial",
        "metavar": "serial|process:N|ray[:ADDRESS]",
        "help": "where the work is done (default: %(default)s)",
    },
    "--fps": {
        "type": float,
        "metavar": "F",
        "help": "of a video: take F frames per second of it, by their time stamps",
    },
    "--ground-truth": {
        "type": Path,
        "metavar": "FILE",
        "help": ".npy or text: boolean [query, reference], one true place per query (-1: none), or"
        " pairs of numbers or file names below 'query,place'; .npz of Patch-NetVLAD: positions",
    },
    "--name": {"help": "what to call it in tables"},
    "--order": {
        **MANY,
        "type": Path,
        "metavar": "FILE",
        "help": "names of images, one on a line, in the order in which they were taken: one file"
        " for both folders, or one for the map and one for the run",
    },
    "--out": {"type": Path, "required": True, "metavar": "BANK", "help": "the folder to write"},
    "--policy": {"metavar": "POLICY", "help": "what decides which techniques run; see above"},
    "--query": {"metavar": "DIR|VIDEO", "help": "the run's images"},
    "--query-positions": {"metavar": "FILE|exif", "help": "likewise, of the run's images"},
    "--reference": {"type": Path, "metavar": "DIR|VIDEO", "help": "the map's images"},
    "--reference-positions": {
        "metavar": "FILE|exif",
        "help": "where the map's images were taken: a table, poses of TUM or KITTI, a ROS bag,"
        " or their EXIF",
    },
    "--seconds": {**MANY, "metavar": "NAME=S", "help": "of one run (default: measured here)"},
    "--seed": {
        "type": int,
        "default": 0,
        "metavar": "S",
        "help": "of what is drawn at random (default: %(default)s)",
    },
    "--skip-damaged": {
        "action": "store_true",
        "help": "leave damaged images out; the others keep their numbers for the ground truth",
    },
    "--techniques": {"metavar": "A,B", "help": f"{', '.join(TECHNIQUES)}, package.module:Class"},
    "--tolerance": {
        "type": int,
        "metavar": "N",
        "help": "places to either side of the true one that count as right, unless the ground"
        " truth lists them itself",
    },
    "--trust": {
        "action": "store_true",
        "help": "unpickle files of VPR-Bench or GSV-Cities, and run the code behind hub:, both of"
        " which may do anything; do you trust their authors?",
    },
    "--weights": {**MANY, "metavar": "NAME=FILE", "help": "in place of those that ship"},
}
