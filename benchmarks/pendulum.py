"""Accuracy and speed of the shipped pendulum emulators: the pendulums' rows of the 1998 table, against MuJoCo in C.

python benchmarks/pendulum.py            table, and results/pendulum.csv
python benchmarks/pendulum.py --json     rows as JSON
python benchmarks/pendulum.py --quick    n = 50 only, fewer repeats; writes no file
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from tempfile import TemporaryDirectory

from neuroanimator.bench.csv_table import write_csv
from neuroanimator.bench.run_table import chosen_rows, run_table
from neuroanimator.machine import describe_machine
from neuroanimator.terminal import print_table

PENDULUMS = "pendulum,pendulum-passive"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print rows as JSON")
    parser.add_argument(
        "--quick", action="store_true", help="n = 50 only, fewer runs; writes no file"
    )
    options = parser.parse_args()
    wanted = chosen_rows(PENDULUMS, "50" if options.quick else None)
    with TemporaryDirectory() as folder:
        rows, _ = run_table(wanted, Path(folder), is_quick=options.quick, seeds=1)
    if not options.quick:
        write_csv(Path(__file__).parent / "results" / "pendulum.csv", rows)
    if options.json:
        print(json.dumps(rows, indent=2))
    else:
        print(describe_machine())
        print_table(rows)


if __name__ == "__main__":
    main()
