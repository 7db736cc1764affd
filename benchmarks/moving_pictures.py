"""Make the moving pictures of the README: a dolphin leaps, a three-link arm swings itself up. Half a minute.

python benchmarks/moving_pictures.py                # into docs/images
python benchmarks/moving_pictures.py --out pictures

Both motions are on the true physics: the springs and the water of the dolphin, MuJoCo's arm. Needs OpenGL (EGL or OSMesa).
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
from pathlib import Path

import imageio_ffmpeg
import numpy as np
from contact_sheets import ROOT, clip_of

import neuroanimator as na
from neuroanimator.control import PhysicsPlant, Planner, control_plant

RATE = 15
"""[1/s] Pictures a second: half of what is drawn, and smooth enough for a loop."""

SIZE = (1280, 720)
"""[pixels] What is drawn, before it is cut and made smaller."""

LEAP_SECONDS = (1.6, 4.2)
"""[s] Of the leap: from the last strokes under water until the dolphin has dived in again."""

LEAP_CUT = "crop=680:612:280:0,scale=360:-2:flags=lanczos"
"""The film's middle and its sky, made 360 pixels wide."""

SWING_CUT = "crop=634:570:323:56,scale=360:-2:flags=lanczos"
"""What the arm reaches, of the leap's size."""

HANGING = 0.3
"""[s] How long the arm is seen hanging before it swings up."""

STANDING = 1.2
"""[s] How long it is seen standing afterwards."""

HORIZON = 20
"""Super steps a plan looks ahead while the arm is held upright: a second."""

PALETTE = (
    "split[picture][sample];"
    "[sample]palettegen=max_colors=160:stats_mode=full[palette];"
    "[picture][palette]paletteuse=dither=bayer:bayer_scale=4:diff_mode=rectangle"
)
"""One palette for the whole loop; an ordered dither does not flicker, and compresses well."""


def main() -> None:
    """Draw both pictures into the folder the command line names."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images")
    folder = parser.parse_args().out
    folder.mkdir(parents=True, exist_ok=True)
    write_loop(part_of(clip_of("leap"), *LEAP_SECONDS), LEAP_CUT, folder / "leap.gif")
    write_loop(swing_up(), SWING_CUT, folder / "swing-up.gif")


def part_of(clip: na.Clip, begin: float, end: float) -> na.Clip:
    """Return the part of `clip` between two times [s]."""
    chosen = (clip.times >= begin) & (clip.times <= end)
    times = clip.times[chosen] - clip.times[chosen][0]
    return na.Clip(clip.name, clip.skeleton, times, clip.states[chosen], clip.definition)


def swing_up() -> na.Clip:
    """Return the arm hanging, swinging itself up by one plan of 1.5 s, and held upright by planning again and again."""
    emulator = na.Emulator.load("pendulum-50")
    system = na.load_system("pendulum")
    found = na.synthesise(
        emulator,
        system,
        na.Objective.of(na.effort(), na.goal(system, "upright")),
        system.rest,
        steps=30,
    )
    swinging = found.outcome.physics_states

    upright = na.goal(system, "upright", since=0, weight=1 / emulator.dt)
    goal = na.Objective.of(na.effort(), upright)
    planner = Planner.of(emulator, goal, HORIZON)
    plant = PhysicsPlant(system, emulator.dt)
    standing = control_plant(planner, plant, swinging[-1], round(STANDING / emulator.dt)).states

    hanging = np.tile(system.rest, (round(HANGING / emulator.dt), 1))
    return na.make_clip(emulator, np.concatenate([hanging, swinging, standing[1:]]))


def write_loop(clip: na.Clip, cut: str, out: Path) -> None:
    """Draw `clip`, cut it by ffmpeg's filter `cut`, and write a GIF that begins again when it ends."""
    with tempfile.TemporaryDirectory() as folder:
        film = Path(folder) / "film.mp4"
        na.write_video(clip, film, size=SIZE)
        filters = f"fps={RATE},{cut},{PALETTE}"
        ffmpeg = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-y"]
        subprocess.run(
            [*ffmpeg, "-i", str(film), "-filter_complex", filters, "-loop", "0", str(out)],
            check=True,
        )
    print(f"{out}: {clip.times[-1]:.1f} s, {out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
