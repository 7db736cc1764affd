"""Make the moving pictures of the README and the documentation: a leap, a swing-up, a shark, a human who walks, one who falls.

python -m tools.moving_pictures       # into docs/images; four minutes
python -m tools.moving_pictures life  # one of them
python -m tools.moving_pictures --out pictures

Leap, swing-up and both humans are on the true physics: flesh and water of the orca, MuJoCo's arm and his body, who is pushed,
or pushed over; his motions are also written as GLB, with pictures of a round of his walk, of getting up, and of
him inside the emulator. They need OpenGL (EGL or OSMesa). The shark's is the studio's page, drawn frame by frame in Chromium;
all of its fish are emulators.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import imageio_ffmpeg
import numpy as np

from benchmarks.following.commanded import Walkers, walked
from benchmarks.following.getting_up import fallen_and_risen
from benchmarks.harness import HUMAN, IMAGES, PROGRAM, ROOT
from tools.contact_sheets import clip_of, tile

sys.path.insert(0, str(ROOT / "tests"))
sys.path.insert(0, str(ROOT / "tests" / "studio"))
from chromium import STEPPED, browsing, hosting, looking

import neuroanimator as na
from neuroanimator.cli.policy_returns import loaded_policy
from neuroanimator.control import PhysicsPlant, Planner, control_plant
from neuroanimator.gym.disturbances import pushed
from neuroanimator.gym.state_rows import EmulatorStepper
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem

RATE = 15
"""[1/s] Pictures a second: half of what is drawn, and smooth enough for a loop."""

SIZE = (1280, 720)
"""[pixels] What is drawn, before it is cut and made smaller."""

LEAP_SECONDS = (2.2, 5.4)
"""[s] Of the leap: from the last strokes under water until the orca has dived in again."""

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

SMALL_FILM = [
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

HUMAN_COMMANDS = (
    (2.5, 0.8, 0.0),
    (3.5, 2.4, 0.0),
    (3.5, 3.8, 0.0),
    (3.5, 2.2, 0.6),
    (3.0, 0.9, 0.0),
)
"""Commands of the human: time [s], speed [m/s] and turning rate [rad/s]; then he is pushed."""

IMPULSE = 30.0
"""[N s] Of the push."""

PUSH_SEED = 0
"""Seed of its direction."""

RECOVERY = 4.5
"""[s] How long he walks on after it, as he was told last."""

WALK_AT = 0.9
"""[s] Time at which a round of the walk begins that is shown step by step."""

RUN_AT = 4.5
"""[s] That of a round of the run."""

INSIDE_COMMANDS = ((3.0, 0.7, 0.0), (4.0, 2.4, 0.4), (3.0, 1.5, 0.0), (3.0, 0.5, -0.6))
"""Commands inside the emulator: time [s], speed [m/s] and turning rate [rad/s]."""

PICTURES = 12
"""Number of pictures on a sheet."""

SHEET_SIZE = (800, 800)
"""[pixels] What is drawn of each, with him in the middle."""

SHEET_CUT = "crop=500:500:150:155"
"""The part of it that is kept."""

HUMAN_SIZE = (960, 720)
"""[pixels] What is drawn, with him in the middle."""

HUMAN_CUT = "crop=480:420:240:120"
"""The part of it that is kept."""

FALL_ANGLE = 2.8
"""[rad] Direction of the push that makes him fall, from straight ahead to the left: nearly from the front."""

FALL_SECONDS = (1.5, 23.0)
"""[s] Of the motion of `getting_up.py`: from walking until he has walked on for some seconds."""

FALL_SHEET = (1.2, 14.0)
"""[s] Its part that is shown step by step."""

FOOD_AT = (2.0, 7.0)
"""[s] Times at which food is dropped."""

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
    makers = {"leap": leap, "swing-up": swing, "life": life, "human": human, "fall": fall}
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", help=", ".join(makers))
    parser.add_argument("--out", type=Path, default=IMAGES)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name in arguments.names or makers:
        makers[name](arguments.out)


def leap(folder: Path) -> None:
    write_loop(part_of(clip_of("breach"), *LEAP_SECONDS), LEAP_CUT, folder / "leap.gif")


def swing(folder: Path) -> None:
    write_loop(swing_up(), SWING_CUT, folder / "swing-up.gif")


def life(folder: Path) -> None:
    """Film the studio's page, where fifty small fish live around one, their shark."""
    with tempfile.TemporaryDirectory() as place, browsing() as browser:
        site, images = Path(place) / "site", Path(place) / "images"
        subprocess.run([PROGRAM, "studio", "--export", site], check=True, capture_output=True)
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
        write_small(["-framerate", str(RATE), "-i", str(images / "%04d.png")], out)
    print(f"{out}: {LIFE_SECONDS:.1f} s, {out.stat().st_size / 1e6:.2f} MB")


def human(folder: Path) -> None:
    """Film a human who walks, runs, turns, walks on, is pushed and recovers, on the physics."""
    policy, system, task = loaded_policy(
        HUMAN / "human.policy.safetensors", HUMAN / "commanded.toml"
    )
    assert isinstance(system, MujocoSystem)
    first = HUMAN_COMMANDS[0][1]
    walkers = Walkers(policy, task, system, 1, (first, first))
    states = []
    for seconds, speed, turning in HUMAN_COMMANDS:
        states += walked_on(walkers, seconds, speed, turning)
    trunk = system.model.body(walkers.trunk).name
    rng = np.random.default_rng(PUSH_SEED)
    walkers.states = pushed(system.model, trunk, walkers.states, np.array([IMPULSE]), rng)
    _, speed, turning = HUMAN_COMMANDS[-1]
    states += walked_on(walkers, RECOVERY, speed, turning)
    clip = na.make_clip(policy.emulator, np.array(states))
    na.write_glb(clip, folder / "human.glb")
    phase = walkers.reference.phase
    write_round(clip, phase, WALK_AT, folder / "human-walk.jpg")
    write_round(clip, phase, RUN_AT, folder / "human-run.jpg")
    stepper = EmulatorStepper(policy.emulator, np.inf, 0.0)
    inside = walked(policy, task, system, list(INSIDE_COMMANDS), stepper)
    write_sheet(na.make_clip(policy.emulator, inside), folder / "human-inside.jpg")
    write_human(clip, folder / "human.mp4")


def fall(folder: Path) -> None:
    """Film a human who is pushed over, rolls onto his front, gets up and walks on, on the physics."""
    fallers, _ = fallen_and_risen(HUMAN / "get-up.policy.safetensors", np.array([FALL_ANGLE]))
    states = np.array(fallers.states)[:, 0]
    clip = part_of(na.make_clip(fallers.walkers.policy.emulator, states), *FALL_SECONDS)
    na.write_glb(clip, folder / "human-falls.glb")
    write_sheet(part_of(clip, *FALL_SHEET), folder / "human-gets-up.jpg")
    write_human(clip, folder / "human-falls.mp4")


def write_human(clip: na.Clip, out: Path) -> None:
    """Film a human small enough for a page of the documentation."""
    with tempfile.TemporaryDirectory() as place:
        drawn = Path(place) / "human.mp4"
        na.write_video(clip, drawn, size=HUMAN_SIZE, camera="follow")
        write_small(["-i", str(drawn), "-vf", HUMAN_CUT], out)
    print(f"{out}: {clip.times[-1]:.1f} s, {out.stat().st_size / 1e6:.2f} MB")


def write_round(clip: na.Clip, phase: int, begin: float, out: Path) -> None:
    """Lay pictures of one round of a gait side by side, from `begin` [s] on; the state entry `phase` is its clock."""
    angles = np.unwrap(clip.states[:, phase])
    first = int(np.searchsorted(clip.times, begin))
    last = int(np.searchsorted(angles, angles[first] + 2 * np.pi))
    write_sheet(part_of(clip, clip.times[first], clip.times[last]), out)


def write_sheet(clip: na.Clip, out: Path) -> None:
    """Lay pictures of a motion, seen from the side, in two rows."""
    chosen = np.linspace(0, len(clip.times) - 1, PICTURES).round().astype(int)
    # At their own times, so that the camera goes along.
    times = np.linspace(0, clip.times[-1] - clip.times[0], PICTURES)
    images = na.Clip(clip.name, clip.skeleton, times, clip.states[chosen], clip.definition)
    with tempfile.TemporaryDirectory() as place:
        drawn = Path(place) / "images.mp4"
        cut = Path(place) / "cut.mp4"
        na.write_video(images, drawn, size=SHEET_SIZE, camera="side")
        write_small(["-i", str(drawn), "-vf", SHEET_CUT], cut)
        tile(cut, list(range(PICTURES)), PICTURES // 2, 2, 250, out)
    print(f"{out}: {out.stat().st_size / 1e6:.2f} MB")


def walked_on(walkers: Walkers, seconds: float, speed: float, turning: float) -> list[np.ndarray]:
    """Return the states (S,) of the one body that walks on under commands [s], [m/s], [rad/s]."""
    walkers.told = np.array([[speed, turning]])
    states = []
    for _ in range(round(seconds / walkers.policy.dt)):
        states.append(walkers.states[0])
        walkers.step()
    return states


def write_small(source: list[str], out: Path) -> None:
    """Write the pictures that ffmpeg reads by the options `source` as a small film."""
    ffmpeg = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-y"]
    subprocess.run([*ffmpeg, *source, "-c:v", *SMALL_FILM, str(out)], check=True)


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
