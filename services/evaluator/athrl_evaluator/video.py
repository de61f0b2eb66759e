"""Films a driver: the town around it, tick by tick, as an MP4 file that every player shows.

ffmpeg writes the file; the package imageio-ffmpeg brings it (`pip install 'athrl[video]'`). Until the video
is complete the file has `.part` appended to its name.
"""

from __future__ import annotations

import os
import re
import select
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import IO, cast

import imageio_ffmpeg
import numpy as np
from athrl_driving.envs import EnvView, TownEnv
from athrl_driving.envs.settings import action_setting
from athrl_driving.policy import AnyBatch, environment_config
from athrl_protocol.run_file import EnvironmentSection
from athrl_spaces.untrusted import one_line
from numpy.typing import NDArray

from athrl_evaluator.errors import EvaluatorError, writing
from athrl_evaluator.evaluate import fitted, make_batch_driver
from athrl_evaluator.scoring.drivers import BatchDriver
from athrl_evaluator.scoring.episodes import Stopped

SMALLEST_SIZE, LARGEST_SIZE = 64, 4096
"""Pixels along a side."""
METRES_ACROSS = 90.0
"""What the shorter side shows."""
QUALITY = 18
"""x264's constant rate factor: to 18 no loss is seen, and each 6 more halve the file."""
FINISH_SECONDS = 120
"""Within which ffmpeg completes the file."""
STALL_SECONDS = 60.0
"""Longest time in which ffmpeg takes nothing of a picture, as when its disk does not answer."""
END_SECONDS = 5.0
"""Within which a killed ffmpeg ends, unless it waits for such a disk."""

_PLACE = re.compile(r"^\[[^]]*\] ")  # where in ffmpeg, before what it says

Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class Shot:
    """What is filmed.

    Attributes:
        town: name of a town, or a map.
        vehicles: number of background vehicles.
        seed: of the first episode; the following ones have the next seeds.
        seconds: length of the video; episodes that end before are followed by others.
        size: width and height in pixels, both even: colours have half as many.
    """

    town: str
    vehicles: int
    seed: int
    seconds: float
    size: tuple[int, int]


def film(
    driver: Path | str, shot: Shot, path: Path, stop: threading.Event, *, overwrite: bool = False
) -> int:
    """Film a policy file or one of REFERENCE_DRIVERS; return the number of pictures.

    Raises:
        InvalidPolicy: the file is no policy.
        DrivingError: the town does not exist or cannot be read.
        EvaluatorError: the file exists, or cannot be written.
        Stopped: `stop` was set before the video was complete; nothing is left of it.
    """
    who, section = fitted(driver, EnvironmentSection(vehicles=shot.vehicles))
    batch_driver = make_batch_driver(who, 1)
    os.environ.setdefault("SDL_VIDEODRIVER", "dummy")  # drawing needs no screen
    env = _environment(section, batch_driver.action_kind, shot)
    try:
        with _written(path, shot.size, env.config["simulation_frequency"], overwrite) as write:
            return _drive(env, batch_driver, shot, write, stop)
    finally:
        env.close()


def _environment(section: EnvironmentSection, action_kind: str, shot: Shot) -> TownEnv:
    settings = section.model_dump()
    settings.pop("towns")
    width, height = shot.size
    view = {
        "screen_width": width,
        "screen_height": height,
        "scaling": min(width, height) / METRES_ACROSS,
        "action": action_setting(action_kind),
    }
    return TownEnv({**environment_config(**settings), **view}, render_mode="rgb_array", map=shot.town)


def _drive(
    env: TownEnv,
    driver: BatchDriver,
    shot: Shot,
    write: Callable[[Picture], object],
    stop: threading.Event,
) -> int:
    """Drive until there are enough pictures; return how many there are."""
    wanted, count, seed = round(shot.seconds * env.config["simulation_frequency"]), 0, shot.seed

    def show() -> None:
        nonlocal count
        picture = env.render()
        if count < wanted:
            assert picture is not None  # of this render mode
            write(picture)
            count += 1

    # highway-env asks a wrapper of this kind for a picture of each tick within a decision.
    env.set_record_video_wrapper(SimpleNamespace(recording=True, _capture_frame=show))
    while count < wanted:
        env.reset(seed=seed)
        driver.begin(0, cast(EnvView, env), seed)
        seed += 1
        ended = False
        while count < wanted and not ended:
            if stop.is_set():
                raise Stopped
            show()
            decisions = driver.decide(_as_batch(env), np.ones(1, np.bool_))
            *_, terminated, truncated, _ = env.step(decisions.actions[0])
            ended = terminated or truncated
    return count


def _as_batch(env: TownEnv) -> AnyBatch:
    """What drivers read of a batch, of one environment."""
    observations = env.episodes.state.observations
    return cast(AnyBatch, _OneEnvironment(observations.images, observations.motion, [env]))


@dataclass(frozen=True)
class _OneEnvironment:
    images: NDArray[np.uint8]
    motion: NDArray[np.float32]
    environments: list[TownEnv]

    def __len__(self) -> int:
        return 1


@contextmanager
def _written(
    path: Path, size: tuple[int, int], pictures_a_second: float, overwrite: bool
) -> Iterator[Callable[[Picture], object]]:
    """Yield a function that adds a picture, uint8 [height, width, 3]; the file is there when all is well."""
    if path.exists() and not overwrite:
        raise EvaluatorError(f"{path} exists already: name another file, or add --overwrite")
    part = path.with_name(f"{path.name}.part")
    with writing(path), tempfile.TemporaryFile() as said:
        try:
            part.touch()
            ffmpeg = subprocess.Popen(
                _command(part, size, pictures_a_second),
                bufsize=0,
                stdin=subprocess.PIPE,
                stdout=said,
                stderr=said,
                process_group=0,  # Ctrl-C in a terminal is for this process, which ends ffmpeg
            )
            try:
                with suppress(BrokenPipeError):  # ffmpeg says why it has ended
                    stream = cast(IO[bytes], ffmpeg.stdin)
                    os.set_blocking(stream.fileno(), False)
                    yield lambda picture: _feed(stream.fileno(), picture, path)
                    stream.close()
                failed = ffmpeg.wait(FINISH_SECONDS) != 0
            except subprocess.TimeoutExpired:
                raise EvaluatorError(
                    f"cannot write {path}: ffmpeg does not complete it within {FINISH_SECONDS:g} s"
                ) from None
            finally:
                ffmpeg.kill()
                with suppress(subprocess.TimeoutExpired):
                    ffmpeg.wait(END_SECONDS)
            if failed:
                said.seek(0)
                raise EvaluatorError(f"cannot write {path}: {_reason(said.read())}")
            part.replace(path)
        finally:
            with suppress(OSError):
                part.unlink(missing_ok=True)


def _feed(pipe: int, picture: Picture, path: Path) -> None:
    """Write a picture into a pipe that does not block, in as many pieces as ffmpeg takes it."""
    waiting = select.poll()
    waiting.register(pipe, select.POLLOUT)
    rest = memoryview(picture.tobytes())
    while rest:
        if not waiting.poll(1000 * STALL_SECONDS):
            raise EvaluatorError(f"cannot write {path}: ffmpeg takes no picture within {STALL_SECONDS:g} s")
        rest = rest[os.write(pipe, rest) :]


def _command(part: Path, size: tuple[int, int], pictures_a_second: float) -> list[str]:
    """ffmpeg's command: raw pictures from its standard input to H.264 that every player shows."""
    width, height = size
    pictures = f"-f rawvideo -pix_fmt rgb24 -s {width}x{height} -r {pictures_a_second:g} -i -"
    video = f"-c:v libx264 -crf {QUALITY} -pix_fmt yuv420p -movflags +faststart -f mp4"
    quiet = ["-hide_banner", "-loglevel", "error", "-y"]
    return [_program(), *quiet, *pictures.split(), *video.split(), f"file:{part}"]


def _program() -> str:
    """ffmpeg's path; raises EvaluatorError if there is none that can be run."""
    try:
        program = imageio_ffmpeg.get_ffmpeg_exe()
    except RuntimeError:
        program = ""
    if shutil.which(program) is None:
        raise EvaluatorError(
            f"there is no program {program or 'ffmpeg'} that can be run: install ffmpeg, or give its path in "
            "IMAGEIO_FFMPEG_EXE"
        )
    return program


def _reason(said: bytes) -> str:
    """The first thing that ffmpeg said, which has caused the others."""
    lines = said.decode(errors="replace").strip().splitlines()
    return one_line(_PLACE.sub("", lines[0])) if lines else "ffmpeg has ended with an error"
