"""Beyond one emulator and one process: the figures of docs/scale.md. Each part writes results/scale_PART.csv.

python benchmarks/scale.py stream           50 million windows in 1 GB, against windows in memory, killed in between
python benchmarks/scale.py stream --quick   the same with 2 million and few updates: a test, no figures
python benchmarks/scale.py bytes            one dataset by processes and by Ray, on one node and on four, with kills: one hash
python benchmarks/scale.py fleet            24 small trainings on four nodes, one of which is killed
python benchmarks/scale.py overhead         Ray beside processes: tasks of 10 ms to 10 s, and shards of the usual size
python benchmarks/scale.py crowd            1 to 10,000 fish and trucks on this machine, on one core and on all
python benchmarks/scale.py costs            cost of a transition in each stage
python benchmarks/scale.py model            the same, extrapolated to 1e12 transitions on 1,000 nodes

Ratios are measured in one run, their two sides in turn.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from scale_cases import costs, crowd, one_hash, overhead, small_fleet, stream

from neuroanimator.evaluation.csv_table import write_csv
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.terminal import print_table

RESULTS = Path(__file__).parent / "results"

PARTS = {
    "stream": stream.measure,
    "bytes": one_hash.measure,
    "fleet": small_fleet.measure,
    "overhead": overhead.measure,
    "crowd": crowd.measure,
    "costs": costs.measure,
    "model": costs.project,
}
"""What is measured, by its name: a function of (folder for what is made on the way, whether it is quick)."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("--quick", action="store_true", help="small, for a look")
    parser.add_argument("--work", type=Path, default=Path("out/scale"), help="for data and runs")
    parser.add_argument("--out", type=Path, help="folder of the table")
    options = parser.parse_args()
    out = options.out or (options.work if options.quick else RESULTS)
    rows = PARTS[options.part](options.work, options.quick)
    write_csv(out / f"scale_{options.part}.csv", rows)
    print_table(rows)
    print(describe_machine())


if __name__ == "__main__":
    main()
