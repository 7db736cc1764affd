"""Draw every system's default film, and the leap, and put twelve frames of each side by side, for inspection.

python -m tools.contact_sheets                   # films and sheets into out/films and out/sheets
python -m tools.contact_sheets --only fish leap  # some of them
python -m tools.contact_sheets images            # the pictures of the README into docs/images
python -m tools.contact_sheets flesh             # trout and orca of flesh beside their physics into docs/images
"""

from __future__ import annotations

import argparse
import runpy
import subprocess
import tempfile
import time
from contextlib import chdir
from pathlib import Path

import imageio_ffmpeg
import numpy as np

import neuroanimator as na
from benchmarks.harness import IMAGES, ROOT
from benchmarks.soft_bodies.equal_error import shipped
from neuroanimator.animation.clip import Clip
from neuroanimator.animation.motion import Drive, default_drive, random_drive
from neuroanimator.control import Steered
from neuroanimator.film.options import read_film
from tools.default_motions import leap_costs

SYSTEMS = ("pendulum", "truck", "lander", "fish", "dolphin")
COLUMNS, ROWS = 3, 4
"""Of a sheet."""
LEAP = ROOT / "examples" / "09_leap.py"
PICTURE = (960, 540)
"""[pixels] Of one image in the README's pictures."""
FLESH_SECONDS, FLESH_RATE = 4.0, 30
"""Length of a motion of flesh [s], and pictures a second of its film."""
FLESH_BEND = 0.35
"""Pull of the muscles on its left while it turns."""
FLESH_PICTURE = (640, 400)
"""[pixels] Of one image of it."""


def main() -> None:
    """Draw what the command line asks for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", nargs="?", choices=("sheets", "images", "flesh"), default="sheets")
    parser.add_argument("--only", nargs="+", choices=(*SYSTEMS, "leap"), default=[*SYSTEMS, "leap"])
    parser.add_argument("--size", default="1280x720")
    parser.add_argument("--camera", default="follow")
    parser.add_argument("--out", type=Path, default=ROOT / "out")
    options = parser.parse_args()
    if options.what == "images":
        write_images(IMAGES)
    elif options.what == "flesh":
        write_flesh(IMAGES)
    else:
        for name in options.only:
            write_sheet(name, options.out, options.size, options.camera)


def tile_motion(clip: Clip, film: Path, images: int, out: Path) -> None:
    """Draw the film of a motion seen from the side, and lay `images` of its pictures in two rows."""
    na.write_video(clip, film, size=(640, 640), camera="side")
    chosen = np.linspace(0, len(clip.times) - 1, images).round().astype(int)
    tile(film, chosen.tolist(), images // 2, 2, 320, out)


def write_sheet(name: str, out: Path, size: str, camera: str) -> None:
    """Draw the film called `name` and the sheet of its images."""
    film = read_film(size, camera)
    motion = clip_of(name)
    began = time.monotonic()
    path = out / "films" / f"{name}.mp4"
    na.write_video(motion, path, size=film.size, camera=film.camera)
    seconds = time.monotonic() - began
    images = len(motion.times)
    first, step = images // (2 * COLUMNS * ROWS), images / (COLUMNS * ROWS)
    chosen = [int(first + number * step) for number in range(COLUMNS * ROWS)]
    sheet = out / "sheets" / f"{name}.jpg"
    tile(path, chosen, COLUMNS, ROWS, 480, sheet)
    print(
        f"{name}: {images} images in {seconds:.1f} s, {path.stat().st_size / 1e3:.0f} kB; {sheet}"
    )


def clip_of(name: str) -> na.Clip:
    """Return the default motion of a system, or a leap on the true physics: the dolphin's, or the `breach` of the orca."""
    if name == "leap":
        with tempfile.TemporaryDirectory() as folder, chdir(folder):
            leap = runpy.run_path(str(LEAP))
        return na.make_clip(leap["emulator"], leap["controller"].outcome.physics_states)
    if name == "breach":
        system, emulator = shipped("orca")
        drive = breach(emulator, system)
        runs = system.simulate(drive.start[None], drive.controls[None], emulator.dt)
        return na.make_clip(emulator, runs.states[0])
    emulator = na.load_emulator(name)
    return na.make_clip(emulator, default_drive(emulator).motion(emulator), source="emulator")


def breach(emulator: na.Emulator, system: na.System) -> Drive:
    """Return an orca of flesh that rises from five metres, leaves the water and dives in nose first, corrected on its physics."""
    depth, seconds, tempo, top, entry = 2.0, 4.8, 1.25, 3.5, 4.3
    steps = round(seconds / emulator.dt)
    start = np.array(system.rest)
    start[2] -= depth
    gait = system.gait
    times = np.arange(steps) * emulator.dt
    bend = np.interp(
        times, [0.0, 0.5, 1.7, 2.7, top, seconds], [0.0, 0.25, 0.25, 0.0, -0.25, -0.12]
    )
    strokes = 0.8 * gait.controls(steps, emulator.dt, emulator.bounds, tempo=tempo)
    first = emulator.bounds.clip(strokes + bend[:, None] * np.sign(gait.amplitudes))
    height = na.reach_height(system, 1.2, within=0.2, at=top)
    objective = na.Objective.of(*leap_costs(system, height, entry, 0.15))
    pattern = Steered.of(steps, emulator.dt, gait.period / tempo, 8, emulator.bounds)
    descent = na.DescentOptions(parametrisation=pattern, first=first)
    options = na.SearchOptions(descent, corrections=6, refinements=0)
    found = na.synthesise(emulator, system, objective, start, steps=steps, options=options)
    return Drive(start, np.concatenate([found.controls, 0.5 * strokes[: round(0.7 / emulator.dt)]]))


def tile(film: Path, chosen: list[int], columns: int, rows: int, width: int, out: Path) -> None:
    """Lay the `chosen` images of a film side by side, each `width` pixels wide."""
    out.parent.mkdir(parents=True, exist_ok=True)
    wanted = "+".join(rf"eq(n\,{number})" for number in chosen)
    layout = f"select={wanted},scale={width}:-2:flags=area,tile={columns}x{rows}:padding=4:margin=4:color=white"
    ffmpeg = imageio_ffmpeg.get_ffmpeg_exe()
    command = [
        ffmpeg,
        "-v",
        "error",
        "-y",
        "-i",
        str(film),
        "-vf",
        layout,
        "-frames:v",
        "1",
        "-q:v",
        "3",
        str(out),
    ]
    subprocess.run(command, check=True)


def write_images(folder: Path) -> None:
    """Draw the README's pictures: two animals, two machines, and a leap in six images."""
    with tempfile.TemporaryDirectory() as scratch:
        pair(["fish", "dolphin"], Path(scratch), folder / "fish-and-dolphin.jpg")
        pair(["truck", "lander"], Path(scratch), folder / "truck-and-lander.jpg")
        leap = clip_of("leap")
        film = Path(scratch) / "leap.mp4"
        na.write_video(leap, film, size=PICTURE)
        tile(film, moments_of_leap(leap), 3, 2, 480, folder / "dolphin-leap.jpg")


def write_flesh(folder: Path) -> None:
    """Draw trout and orca under the same controls, in turn by the physics and by the emulator: first, middle, last image."""
    sheets = []
    with tempfile.TemporaryDirectory() as scratch:
        for name in ("trout", "orca"):
            system, emulator = shipped(name)
            swum = random_drive(emulator, FLESH_SECONDS, 0)
            bent = ["_l" in muscle for muscle in emulator.control.names]
            turned = emulator.bounds.clip(0.6 * swum.controls + FLESH_BEND * np.array(bent))
            drives = [swum, Drive(swum.start, turned)]
            if name == "orca":
                drives.append(breach(emulator, system))
            for drive in drives:
                runs = system.simulate(drive.start[None], drive.controls[None], emulator.dt)
                for states in (runs.states[0], drive.motion(emulator)):
                    film = Path(scratch) / f"{len(sheets)}.mp4"
                    na.write_video(na.make_clip(emulator, states), film, size=FLESH_PICTURE)
                    sheets.append(film.with_suffix(".jpg"))
                    count = round(FLESH_RATE * (len(states) - 1) * emulator.dt)
                    tile(film, [0, count // 2, count - 1], 3, 1, 320, sheets[-1])
        inputs = [word for sheet in sheets for word in ("-i", str(sheet))]
        stack = ["-filter_complex", f"vstack=inputs={len(sheets)}", "-q:v", "4"]
        command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-y", *inputs, *stack]
        subprocess.run([*command, str(folder / "flesh.jpg")], check=True)


def pair(names: list[str], scratch: Path, out: Path) -> None:
    """Lay one image of each of two films side by side: the one in the middle."""
    stills = []
    for name in names:
        film = scratch / f"{name}.mp4"
        motion = clip_of(name)
        na.write_video(motion, film, size=PICTURE)
        still = scratch / f"{name}.png"
        tile(film, [len(motion.times) // 2], 1, 1, PICTURE[0] * 3 // 4, still)
        stills += ["-i", str(still)]
    command = [
        imageio_ffmpeg.get_ffmpeg_exe(),
        "-v",
        "error",
        "-y",
        *stills,
        "-filter_complex",
        "hstack",
        "-q:v",
        "3",
    ]
    out.parent.mkdir(parents=True, exist_ok=True)
    subprocess.run([*command, str(out)], check=True)


def moments_of_leap(leap: na.Clip) -> list[int]:
    """Return six images around the highest point of the body's middle."""
    positions, _ = leap.skeleton.world_poses(leap.states)
    highest = int(positions[..., 2].mean(axis=1).argmax())
    last = len(leap.times) - 1
    return sorted({int(np.clip(highest + number, 0, last)) for number in (-18, -11, -5, 0, 6, 12)})


if __name__ == "__main__":
    main()
