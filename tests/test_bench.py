"""The bench runs from its command line, checks itself, and writes what it promises."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

SCRIPT = Path(__file__).parent.parent / "scripts" / "bench.py"
KEYS = {
    "sic_vs_numpy",
    "sic_share_of_limit",
    "vector_env_vs_cartpole_vector",
    "single_env_vs_cartpole",
    "half_step_vs_whole",
    "carry_step_vs_without",
    "discount_step_vs_without",
    "belief_step_vs_evidence",
    "belief_two_threads_vs_one",
    "ppo_vs_constant_env",
    "import_seconds",
    "first_step_cold_seconds",
    "first_step_cached_seconds",
    "belief_first_step_cold_seconds",
    "belief_first_step_cached_seconds",
    "hog_describe_ms",
    "cohog_describe_ms",
    "calc_describe_ms",
    "netvlad_describe_ms",
    "live_hog_frames_per_second",
    "live_overhead_ms",
    "belief_live_overhead_ms",
}


def bench(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-W", "error", str(SCRIPT), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=900, check=False)


def test_quick_bench_writes_finite_numbers(tmp_path):
    out = tmp_path / "new" / "bench.json"
    done = bench("--quick", "--out", str(out))
    assert (done.returncode, done.stderr) == (0, "")
    ratios = json.loads(out.read_text(encoding="utf-8"))
    assert ratios.keys() == KEYS
    assert all(math.isfinite(ratio) for ratio in ratios.values()), ratios
    assert all(ratio > 0.0 for ratio in ratios.values()), ratios
    assert all(key in done.stdout for key in KEYS)
    assert "def gather(" in done.stdout


def test_bench_refuses_a_folder_in_one_line(tmp_path):
    done = bench("--quick", "--out", str(tmp_path))
    assert done.returncode == 2
    assert "name a file" in done.stderr
    assert done.stderr.count("\n") == 1


def test_only_some_ratios_are_measured(tmp_path):
    done = bench("--quick", "--only", "sic_vs_numpy", "--out", str(tmp_path / "bench.json"))
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads((tmp_path / "bench.json").read_text("utf-8")).keys() == {"sic_vs_numpy"}
