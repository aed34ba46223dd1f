"""Print the rows of the README's table of public recordings, as the present program computes them.

    python docs/tools/headline_numbers.py $WCLM_DATASETS

The directory has NAME/NAME.clf and NAME/NAME.relations of the recordings. Takes a minute of processor time.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

RECORDINGS = {"intel": "Intel Research Lab", "fr079": "Freiburg, building 079", "csail": "MIT CSAIL"}
WCLM = [sys.executable, "-c", "from slam.cli import main; main()"]


def row(name: str, title: str, datasets: Path, folder: Path) -> str:
    """Return the row of a recording: driven way, errors, processor time, speed, size of the map."""
    recording, out = datasets / name / f"{name}.clf", folder / name
    before = os.times()
    subprocess.run([*WCLM, "run", recording, "--out", out, "--no-review"], check=True, stdout=subprocess.DEVNULL)
    after = os.times()
    seconds = after.children_user + after.children_system - before.children_user - before.children_system
    relations = recording.with_suffix(".relations")
    scored = [*WCLM, "eval", out / "trajectory.tum", "--relations", relations, "--json"]
    scores = json.loads(subprocess.run(scored, check=True, capture_output=True, text=True).stdout)
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    kilobytes = round((out / "map.json").stat().st_size / 1000)
    cells = [
        title,
        f"{summary['path_length']:.0f} m, {summary['duration'] / 60:.0f} min",
        f"{scores['trans_mean']:.4f} ± {scores['trans_std']:.4f}",
        f"{scores['trans_median']:.4f}",
        f"{scores['rot_mean']:.2f}",
        f"{seconds:.0f} s",
        f"{summary['duration'] / seconds:.0f} x",
        f"{summary['walls']} walls, {summary['corners']} corners, {kilobytes} kB",
    ]
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    with tempfile.TemporaryDirectory() as folder:
        for name, title in RECORDINGS.items():
            print(row(name, title, Path(sys.argv[1]), Path(folder)), flush=True)
