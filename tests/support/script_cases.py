"""Scripts in processes of their own, stopped on their way."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"

# A process that sends itself a signal after so many lines; a shell may have started these tests
# with Ctrl-C ignored.
STOPPED = """
import os, runpy, signal, sys
number, lines, *sys.argv = int(sys.argv[1]), int(sys.argv[2]), *sys.argv[3:]
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.path.insert(0, os.path.dirname(sys.argv[0]))
class Counted:
    def __init__(self, stream, left):
        self.stream, self.left = stream, left
    def __getattr__(self, name):
        return getattr(self.stream, name)
    def write(self, text):
        self.stream.write(text)
        self.stream.flush()
        self.left -= text.count("\\n")
        if self.left == 0:
            self.left = -1
            os.kill(os.getpid(), number)
sys.stdout = Counted(sys.stdout, lines)
runpy.run_path(sys.argv[0], run_name="__main__")
"""


class Done(NamedTuple):
    returncode: int
    stdout: str
    stderr: str


def run_and_stop(number: int, lines: int, script: str, *arguments: object) -> Done:
    """The script in a process that gets signal `number` when it has printed so many lines."""
    path = SCRIPTS / script
    words = [sys.executable, "-W", "error", "-c", STOPPED, int(number), lines, path, *arguments]
    process = subprocess.run(
        [*map(str, words)], capture_output=True, text=True, timeout=240, check=False
    )
    return Done(process.returncode, process.stdout, process.stderr)
