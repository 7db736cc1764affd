"""Make the moving pictures of the README and the documentation: a leap, a swing-up, and a shark among small fish.

python benchmarks/moving_pictures.py                # into docs/images; three minutes
python benchmarks/moving_pictures.py life           # one of them
python benchmarks/moving_pictures.py --out pictures

Leap and swing-up are on the true physics: the springs and the water of the dolphin, MuJoCo's arm. They need OpenGL (EGL or
OSMesa). The shark's is the studio's page, an image at a time, as Chromium draws it; all of its fish are emulators.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import imageio_ffmpeg
import numpy as np
from contact_sheets import ROOT, clip_of

sys.path.insert(0, str(ROOT / "tests" / "studio"))
from chromium import browsing, hosting, looking

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

LIFE_SECONDS = 14.0
"""[s] Length of the shark's film."""

LIFE_SIZE = (640, 360)
"""[pixels]"""

LIFE_FILM = [
    "libx264",
    "-preset",
    "veryslow",
    "-crf",
    "30",
    "-pix_fmt",
    "yuv420p",
    "-movflags",
    "+faststart",
]
"""How it is written: half a megabyte."""

FOOD_AT = (2.0, 7.0)
"""[s] Times at which food is dropped."""

STEPPED = """
let now = 0;
let waiting = [];
performance.now = () => now;
window.requestAnimationFrame = (draw) => waiting.push(draw);
window.nextImage = (milliseconds) => {
    now += milliseconds;
    const due = waiting;
    waiting = [];
    due.forEach((draw) => draw(now));
};
"""
"""The page's time goes on when it is told, so that a slow machine films as smoothly; what fish do differs from film to film."""

ALONE = (
    "body > :not(main) { display: none !important } main { position: fixed !important; inset: 0 }"
)
"""The stage without what is around it."""

BE_THE_SHARK = """() => {
    const button = [...document.querySelectorAll("button")].find((one) => one.textContent === "Be the shark");
    button?.click();
    return button !== undefined;
}"""
"""Clicks the button, if the page has it already."""

PALETTE = (
    "split[picture][sample];"
    "[sample]palettegen=max_colors=160:stats_mode=full[palette];"
    "[picture][palette]paletteuse=dither=bayer:bayer_scale=4:diff_mode=rectangle"
)
"""One palette for the whole loop; an ordered dither does not flicker, and compresses well."""


def main() -> None:
    """Make the pictures that the command line names."""
    makers = {"leap": leap, "swing-up": swing, "life": life}
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", help=", ".join(makers))
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name in arguments.names or makers:
        makers[name](arguments.out)


def leap(folder: Path) -> None:
    write_loop(part_of(clip_of("leap"), *LEAP_SECONDS), LEAP_CUT, folder / "leap.gif")


def swing(folder: Path) -> None:
    write_loop(swing_up(), SWING_CUT, folder / "swing-up.gif")


def life(folder: Path) -> None:
    """Film the studio's page, where fifty small fish live around one, their shark."""
    with tempfile.TemporaryDirectory() as place, browsing() as browser:
        site, images = Path(place) / "site", Path(place) / "images"
        program = Path(sys.executable).with_name("neuroanimator")
        subprocess.run([program, "studio", "--export", site], check=True, capture_output=True)
        width, height = LIFE_SIZE
        with hosting(site) as host, looking(browser, {"width": width, "height": height}) as looked:
            page = looked.page
            page.add_init_script(STEPPED)
            page.goto(f"{host}/index.html?show=fish-50")
            while not page.evaluate(BE_THE_SHARK):
                page.evaluate("nextImage(16)")
                page.wait_for_timeout(200)
            page.add_style_tag(content=ALONE)
            images.mkdir()
            for number in range(round(LIFE_SECONDS * RATE)):
                if number in [round(time * RATE) for time in FOOD_AT]:
                    page.mouse.click(0.45 * width, 0.4 * height)
                page.evaluate(f"nextImage({1000 / RATE})")
                page.screenshot(path=images / f"{number:04}.png")
        out = folder / "life.mp4"
        ffmpeg = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-y", "-framerate", str(RATE)]
        film = [*ffmpeg, "-i", str(images / "%04d.png"), "-c:v", *LIFE_FILM, str(out)]
        subprocess.run(film, check=True)
    print(f"{out}: {LIFE_SECONDS:.1f} s, {out.stat().st_size / 1e6:.2f} MB")


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
