"""The trout of flesh in meshes of 300 to 4,060 nodes, each with an emulator of its own: shapes, units, time, errors, factor.

python -m benchmarks.soft_bodies.animal_sizes                45 minutes of two cores; a picture and animal_sizes.csv
python -m benchmarks.soft_bodies.animal_sizes --folder sizes keeps data and emulators, and goes on where it stopped

Every one takes as much data and as many updates, and finds its own shapes. The factor is the time of the cheapest physics of
the same mesh and coarser ones that is as accurate as the emulator after a second, over the emulator's (see equal error).
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from matplotlib.figure import Figure

import neuroanimator as na
from benchmarks.harness import IMAGES, Rows, keep_rows, parser_of, show_rows
from benchmarks.soft_bodies.equal_error import ASSETS, EMULATOR, SHOWN, raced
from benchmarks.soft_bodies.families import FAMILIES, Shape
from benchmarks.soft_bodies.own_flex import Extent, learnt
from neuroanimator.learn.evaluation.speed import one_core
from neuroanimator.physics.soft.soft_system import SoftSystem
from tools.soft_meshes import msh_text, trout_animal

RESULTS = Path(__file__).with_suffix(".csv")

PICTURE = IMAGES / "animal-sizes.png"

NAME = "trout"

SHAPES = ((20, 5, 3), (28, 6, 3), (36, 9, 3), (44, 9, 5), (58, 14, 5))
"""Nodes along, up and across."""

EXTENT = Extent(count=24_576, updates=6_000)

QUICK = Extent(count=960, updates=500)


def size_row(shape: Shape, folder: Path, extent: Extent) -> dict[str, object]:
    """Return what the trout of this mesh takes, and how accurate its emulator is."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{NAME}.msh").write_text(msh_text(*trout_animal(shape)))
    toml = folder / f"{NAME}.toml"
    toml.write_bytes((ASSETS / toml.name).read_bytes())
    emulator = learnt(toml, extent)
    system = na.load_system(str(toml))
    assert isinstance(system, SoftSystem)
    rows, factors = raced(NAME, system, emulator, FAMILIES[NAME]._replace(shape=shape))
    last = factors[-1]
    teacher = max(row["us_a_super_step"] or 0.0 for row in rows)
    return {
        "nodes": len(system.scene.positions),
        "shapes": len(system.shapes.modes),
        "units": sum(emulator.network.widths),
        "teacher_us": teacher,
        "emulator_us": next(row for row in rows if row["what"] == EMULATOR)["us_a_super_step"],
        f"error_{SHOWN[-1]}_percent": last["error_percent"],
        "as_exact": last["as_exact"],
        "times_faster": last["times_faster"],
    }


def draw(rows: Rows) -> None:
    """Draw times and the factor over the number of nodes."""
    figure = Figure(figsize=(9, 3.4), layout="constrained")
    times, gain = figure.subplots(1, 2)
    nodes = [row["nodes"] for row in rows]
    times.loglog(nodes, [row["teacher_us"] for row in rows], "o-", label="physics in C")
    times.loglog(nodes, [row["emulator_us"] for row in rows], "s-", label="emulator")
    times.set_ylabel("µs a super step")
    times.legend()
    gain.loglog(nodes, [row["times_faster"] for row in rows], "o-")
    gain.set_ylabel("times faster at equal error")
    for axes in (times, gain):
        axes.set_xlabel("nodes")
        axes.set_xticks(nodes, labels=[str(number) for number in nodes])
        axes.minorticks_off()
        axes.yaxis.set_major_formatter("{x:,.0f}")
    gain.set_yticks([500, 1000, 2000, 5000])
    figure.savefig(PICTURE, dpi=110)


def main() -> None:
    parser = parser_of(__doc__, quick="little data and training, no picture")
    parser.add_argument("--folder", type=Path, help="for data and emulators")
    options = parser.parse_args()
    extent = QUICK if options.quick else EXTENT
    rows: Rows = []
    with TemporaryDirectory() as temporary, one_core():
        for shape in SHAPES:
            folder = (options.folder or Path(temporary)) / "x".join(map(str, shape))
            rows.append(size_row(shape, folder, extent))
            show_rows(rows[-1:])
    show_rows(rows)
    keep_rows(RESULTS, rows, options)
    if not options.quick:
        draw(rows)


if __name__ == "__main__":
    main()
