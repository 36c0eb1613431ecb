"""``topcli animate``: the spinning body of a stored run as a GIF or a video."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from topcli.cli.options import Json
from topcli.cli.output import ProgressDisplay, emit, print_json, print_message

Run = Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run, such as results/NAME.")]
Out = Annotated[Path, typer.Option("--out", metavar="FILE", help="Write this file, a .gif or an .mp4.")]
Fps = Annotated[
    float, typer.Option("--fps", metavar="RATE", min=1.0, max=120.0, help="Show this number of frames per second.")
]
Seconds = Annotated[
    float, typer.Option("--seconds", metavar="SECONDS", min=0.1, max=600.0, help="Make it last this long.")
]
Size = Annotated[int, typer.Option("--size", metavar="PIXELS", min=240, max=3840, help="Set the width; 3:2.")]
Start = Annotated[float | None, typer.Option("--start", metavar="T", help="Begin at this time of the run.")]
Stop = Annotated[
    float | None,
    typer.Option("--stop", metavar="T", help="End at this time; by default as far as the motion is smooth."),
]


def animate(
    run: Run,
    out: Out,
    fps: Fps = 25.0,
    seconds: Seconds = 10.0,
    size: Size = 720,
    start: Start = None,
    stop: Stop = None,
    as_json: Json = False,
) -> None:
    """Animate the body of a run, with the trace of its axis.

    The attitude is that of the run (output.attitude), or it is reconstructed from densely recorded rows. An .mp4
    needs pip install 'topcli[video]'; a .gif needs nothing more.
    """
    from topcli.figures.animation import animate as draw
    from topcli.figures.animation import encoder_for, planned
    from topcli.figures.body_motion import stored_body_motion

    encoder_for(out, fps, seconds)  # before anything is read or drawn
    motion = stored_body_motion(run)
    for note in motion.notes:
        print_message(note)
    film = planned(motion, fps, seconds, size, start, stop)
    begin, end, last = float(film.times[0]), float(film.times[-1]), float(motion.t[-1])
    if stop is None and end != last:
        print_message(
            f"{motion.experiment.name}: shows t = {begin:g} to {end:.4g} of {last:g}; --stop {last:g} shows all, faster"
        )
    display = ProgressDisplay(1, as_json, unit="frames")
    display.begin(str(out))
    try:
        draw(motion, film, out, display)
    finally:
        display.close()
    frames, (width, height) = len(film.times), film.size
    if as_json:
        content = {"file": str(out), "frames": frames, "fps": fps, "width": width, "height": height}
        print_json("animate", {"run": motion.experiment.name, **content, "t_first": begin, "t_last": end})
    else:
        emit(f"{motion.experiment.name}: {frames} frames, {width} x {height} -> {out}")
