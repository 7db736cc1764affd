"""Soft bodies of thousands of nodes beside the physics; each part writes soft_bodies_PART.csv.

python -m benchmarks.soft_bodies.soft_bodies equal_error [cape flag jelly trout orca]  emulators that ship: error and time
python -m benchmarks.soft_bodies.soft_bodies flex [cape flag jelly]         the same meshes as flexes of MuJoCo
python -m benchmarks.soft_bodies.soft_bodies own_flex [cloth jelly]         a user's own flexes; --folder keeps all files

Equal error: runs of 1 s along smooth random paths of the movers that training never saw, some time after rest. The truth is
the teacher's physics with all nodes. The emulator is compared with the physics started from its state (nodes decoded from the
shapes), the initial shape carried along, and cheaper physics: fewer small steps, coarser meshes, whose nodes are interpolated.
Errors are of all nodes [% of the body's size, root mean square]: mean and 95th percentile of runs; of normals the mean angle.
Times are of one core, one body, in float32, in turn. A factor is the time of the cheapest physics that is as accurate as the
emulator, over the emulator's.

Flex: cape, flag and jelly as MuJoCo's flexes, attached to the same movers, from rest, for 1 s along
a smooth random path that does not turn; without air, and without colliders. Materials follow the definitions as far
as MuJoCo has them. `full` is the whole mesh, elastic; `full, edges as equalities` a cloth as in MuJoCo's documentation,
shown with its time alone; `trilinear` and `quadratic` are MuJoCo's reduced bodies, with 8 and 27 nodes of a surrounding
box. Errors are of all nodes [% of the size, root mean square], from `full` in 64 steps per super step. All are timed in
turn with the emulator's super step.

Own flexes: two typical MuJoCo models (`models`), a cloth of 225 nodes tied to a bar
and a jelly of 216 on the ground that a paddle strikes, taken without an edit from `new` to an emulator, with half (cloth)
and a quarter (jelly) of the usual data and updates. Errors are those of equal error, the physics MuJoCo's in the teacher's,
the model's own and longer steps.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.harness import Rows, keep_rows, parser_of, show_rows
from benchmarks.soft_bodies.equal_error import equal_error_rows
from benchmarks.soft_bodies.families import FAMILIES
from benchmarks.soft_bodies.flex import HELD_SIDE, flex_rows
from benchmarks.soft_bodies.own_flex import EXTENTS, own_flex_rows
from benchmarks.soft_bodies.own_flex import QUICK as QUICK_FLEX
from neuroanimator.learn.evaluation.speed import one_core

RESULTS = Path(__file__).parent


def equal_error(options: argparse.Namespace) -> None:
    """Print and write each body's rows, and its factors at equal error."""
    rows: Rows = []
    factors: Rows = []
    names = options.names or list(FAMILIES)
    for name in names:
        of_body, factors_of_body = equal_error_rows(name, by_reference=options.by_reference)
        rows += of_body
        factors += factors_of_body
        show_rows(of_body)
    show_rows(factors)
    keep_rows(RESULTS / "soft_bodies_errors.csv", rows, options, "body", "what")
    keep_rows(RESULTS / "soft_bodies_factors.csv", factors, options, "body", "super_steps")


def flex(options: argparse.Namespace) -> None:
    """Print and write each body's rows."""
    rows = flex_rows(options.names or list(HELD_SIDE), is_quick=options.quick)
    show_rows(rows)
    keep_rows(RESULTS / "soft_bodies_flex.csv", rows, options)


def own_flex(options: argparse.Namespace) -> None:
    """Print and write each model's rows."""
    rows: Rows = []
    names = options.names or list(EXTENTS)
    with TemporaryDirectory() as temporary:
        for name in names:
            extent = QUICK_FLEX if options.quick else EXTENTS[name]
            rows += own_flex_rows(name, options.folder or Path(temporary), extent)
    show_rows(rows)
    if names == list(EXTENTS):
        keep_rows(RESULTS / "soft_bodies_own_flex.csv", rows, options)


PARTS = {"equal_error": equal_error, "flex": flex, "own_flex": own_flex}


def main() -> None:
    parser = parser_of(__doc__, quick="of flex and own_flex: little data and motion")
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("names", nargs="*", metavar="BODY")
    parser.add_argument("--folder", type=Path, help="of own_flex: for data and emulators")
    parser.add_argument(
        "--by-reference", action="store_true", help="of equal_error: the truth is in finer steps"
    )
    options = parser.parse_args()
    with one_core():
        PARTS[options.part](options)


if __name__ == "__main__":
    main()
