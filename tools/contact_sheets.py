"""Draw every system's default film, and the leap, and put twelve frames of each side by side, for inspection.

python -m tools.contact_sheets                   # films and sheets into out/films and out/sheets
python -m tools.contact_sheets --only fish leap  # some of them
python -m tools.contact_sheets images            # the pictures of the README into docs/images
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
from neuroanimator.animation.clip import Clip
from neuroanimator.animation.motion import default_drive
from neuroanimator.film.options import read_film

SYSTEMS = ("pendulum", "truck", "lander", "fish", "dolphin")
COLUMNS, ROWS = 3, 4
"""Of a sheet."""
LEAP = ROOT / "examples" / "09_leap.py"
PICTURE = (960, 540)
"""[pixels] Of one image in the README's pictures."""


def main() -> None:
    """Draw what the command line asks for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", nargs="?", choices=("sheets", "images"), default="sheets")
    parser.add_argument("--only", nargs="+", choices=(*SYSTEMS, "leap"), default=[*SYSTEMS, "leap"])
    parser.add_argument("--size", default="1280x720")
    parser.add_argument("--camera", default="follow")
    parser.add_argument("--out", type=Path, default=ROOT / "out")
    options = parser.parse_args()
    if options.what == "images":
        write_images(IMAGES)
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
    """Return the default motion of a system, or the leap on the true physics."""
    if name == "leap":
        with tempfile.TemporaryDirectory() as folder, chdir(folder):
            leap = runpy.run_path(str(LEAP))
        return na.make_clip(leap["emulator"], leap["controller"].outcome.physics_states)
    emulator = na.load_emulator(name)
    return na.make_clip(emulator, default_drive(emulator).motion(emulator), source="emulator")


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
