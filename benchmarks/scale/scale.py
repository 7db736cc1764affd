"""Beyond one emulator and one process: the figures of docs/scale.md. Each part writes scale_PART.csv.

python -m benchmarks.scale.scale stream          50 million windows in 1 GB, against windows in memory, killed in between
python -m benchmarks.scale.scale stream --quick  the same with 2 million and few updates: a test, no figures
python -m benchmarks.scale.scale crowd           1 to 10,000 fish and trucks on this machine, on one core and on all
python -m benchmarks.scale.scale costs           cost of a transition in each stage
python -m benchmarks.scale.scale model           the same, extrapolated to 1e12 transitions on 1,000 nodes

Ratios are measured in one run, their two sides in turn.
"""

from __future__ import annotations

from pathlib import Path

from benchmarks.harness import keep_rows, parser_of, show_rows
from benchmarks.scale import costs, crowd, stream

RESULTS = Path(__file__).parent

PARTS = {
    "stream": stream.measure,
    "crowd": crowd.measure,
    "costs": costs.measure,
    "model": costs.project,
}
"""What is measured, by its name: a function of (folder for what is made on the way, whether it is quick)."""


def main() -> None:
    parser = parser_of(__doc__, quick="small, for a look")
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("--work", type=Path, default=Path("out/scale"), help="for data and runs")
    options = parser.parse_args()
    rows = PARTS[options.part](options.work, options.quick)
    show_rows(rows)
    keep_rows(RESULTS / f"scale_{options.part}.csv", rows, options)


if __name__ == "__main__":
    main()
