"""The drawing process of `write_video`: clips come in as .npz on stdin, an MP4 goes out, image numbers on stdout.

Without arguments it only tries whether drawing works at all.
"""

from __future__ import annotations

import sys

NO_GRAPHICS = 17
"""Exit code of a process that has no OpenGL to draw with."""


def main(arguments: list[str]) -> int:
    """Return the exit code; what cannot draw says so before anything else is imported."""
    try:
        import mujoco

        context = mujoco.GLContext(16, 16)
        context.make_current()
        # Without a display GLFW gives a context that draws nothing.
        empty = mujoco.MjModel.from_xml_string("<mujoco/>")
        mujoco.MjrContext(empty, mujoco.mjtFontScale.mjFONTSCALE_100)
    except Exception as error:  # each library fails in its own way
        print(f"no OpenGL: {error}", file=sys.stderr)
        return NO_GRAPHICS
    if arguments:
        from neuroanimator.export.film.draw_video import draw_video

        draw_video(arguments[0], sys.stdin.buffer.read())
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
