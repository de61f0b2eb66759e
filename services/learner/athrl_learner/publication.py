"""When policies are published, under which version, and with how much noise."""

from __future__ import annotations

import hashlib
import json
import logging
import time
from collections.abc import Callable
from pathlib import Path

from athrl_planners import PolicyExporter
from athrl_protocol import PolicyUpdate

from athrl_learner.arrivals import Arrivals
from athrl_learner.run_folder import RunFolder, write_atomically

log = logging.getLogger(__name__)


def annealed_noise(environment_steps: int, target: int, final_scale: float) -> float:
    """Factor on the exploration noise: falls linearly from 1 to `final_scale` over `target` steps."""
    return 1.0 + (final_scale - 1.0) * min(1.0, environment_steps / target)


def recorded_version(facts: Path) -> int:
    """The newest version that ever was published according to `policies/latest.json`; -1 if unknown.

    A learner that was killed goes on from a checkpoint older than its last publication. Its versions must
    not repeat those that actors already have, or they would take the new policies for old ones.
    """
    try:
        version = json.loads(facts.read_bytes())["version"]
    except (OSError, ValueError, KeyError, TypeError):
        return -1
    return version if isinstance(version, int) else -1


class Publication:
    """Publishes the averaged actors: `hand_out` brings them to the run; also as `policies/latest.onnx`."""

    def __init__(
        self,
        hand_out: Callable[[PolicyUpdate], object],
        exporter: PolicyExporter,
        folder: RunFolder,
        arrivals: Arrivals,
        *,
        seconds: float,
        final_noise_scale: float,
        environment_steps_target: int,
    ) -> None:
        self.version = -1  # the newest published
        self.noise_scale = 1.0  # that went with it
        self._hand_out = hand_out
        self._exporter = exporter
        self._folder = folder
        self._arrivals = arrivals
        self._seconds = seconds
        self._final_noise_scale = final_noise_scale
        self._target = environment_steps_target
        self._published_at = -seconds
        self._published_updates = -1

    def go_on(self, version: int) -> None:
        """Take `version` for the newest that was published: the next one is above it."""
        self.version = version
        self._arrivals.published_version = version

    def due(self, updates: int) -> bool:
        """Whether there was an update since the last publication, and enough time."""
        return updates != self._published_updates and time.monotonic() - self._published_at >= self._seconds

    def publish(self, *, updates: int, environment_steps: int, uniform_exploration: bool) -> None:
        """Publish the weights as they are now under the next version.

        The files are written first: a version that an actor has is never unknown to the run's folder.
        """
        update = PolicyUpdate(
            version=self.version + 1,
            artefact=self._exporter.artefact(),
            uniform_exploration=uniform_exploration,
            noise_scale=annealed_noise(environment_steps, self._target, self._final_noise_scale),
            updates=updates,
            environment_steps=environment_steps,
            published_at=time.time(),
        )
        self._write_files(update)
        self._hand_out(update)
        self.version, self.noise_scale = update.version, update.noise_scale
        self._arrivals.published(update.version)
        self._published_at = time.monotonic()
        self._published_updates = updates

    def _write_files(self, update: PolicyUpdate) -> None:
        facts = {
            "version": update.version,
            "updates": update.updates,
            "environment_steps": update.environment_steps,
            "sha256": hashlib.sha256(update.artefact).hexdigest(),
        }
        try:
            write_atomically(self._folder.latest_policy_facts, json.dumps(facts, indent=1).encode())
            write_atomically(self._folder.latest_policy, update.artefact)
        except OSError as error:
            log.warning("cannot write %s: %s", self._folder.latest_policy, error.strerror)
