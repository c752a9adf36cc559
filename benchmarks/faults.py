"""A long run on two ranks with random faults on one of them, resumed after each until it is through: what it loses.

    ./run python3 benchmarks/faults.py --steps 1000 --faults 20

Faults are exceptions anywhere in Python or in a callback, files that cannot be written, and SIGKILL, each at a random moment
of start-up or of the next few dozen steps. The history must have every step once, with the numbers of an undisturbed run.
"""

import argparse
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parents[1] / "tests"), str(Path(__file__).resolve().parents[1])]
from test_checkpoint import assert_same_history, command, rows, run_with_faults

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=1000, help="load steps (%(default)s)")
    parser.add_argument("--faults", type=int, default=20, help="how many (%(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        whole, cut = Path(folder) / "whole", Path(folder) / "cut"
        subprocess.run([*command("bending", 2, whole), "--steps", str(args.steps)], check=True, capture_output=True)
        struck = run_with_faults(cut, args.steps, args.seed, args.faults)
        assert_same_history(cut, whole, 1e-7)
        load = rows(cut)["load"]
        assert len(np.unique(load)) == len(load)
        kinds = ", ".join(f"{n} × {kind}" for kind, n in sorted(Counter(struck).items()))
        print(f"{len(load)} steps, {len(struck)} faults ({kinds}): all steps there, numbers to 1e-7")
